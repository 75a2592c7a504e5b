"""C functions of one energy near rest, by increments (small_strain.h)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy

from fem_snh.kernels.codegen.c_functions import Functions
from fem_snh.kernels.codegen.derivatives import I_C, II_C, J
from fem_snh.kernels.codegen.increments import AboutRest
from fem_snh.kernels.codegen.printer import statements
from fem_snh.materials.energy import Energy
from fem_snh.materials.functions import fractions, where
from fem_snh.materials.invariants import SIGMA

#: The measures that small_strain.h knows the changes of, in its order, and their values at rest.
_INVARIANTS = {I_C: 3, II_C: 3, J: 1}
_STRETCHES = dict.fromkeys(SIGMA, 1)


#: J - 1 of the mean volume of a cell, and up to where it is what counts.
VOLUME_CHANGE = sympy.Symbol("change", real=True)
_FAR = sympy.Rational(1, 4)


def volume_near_rest(curve: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """Expressions in J that are written in J - 1 where that is small."""
    about = AboutRest({J: (sympy.Integer(1), VOLUME_CHANGE)})
    return [where(_FAR - sympy.Abs(VOLUME_CHANGE), sympy.Add(*about(f)), f) for f in curve]


class NearRest:
    """Energy and stress of one energy near rest; the arguments are changes from rest.

    An energy that needs the stretches is written in them, any other in the invariants.
    """

    def __init__(self, energy: Energy) -> None:
        self.energy = energy
        self._c = Functions(energy)
        rest = _STRETCHES if energy.needs_stretches else _INVARIANTS
        self._change = {m: sympy.Symbol(f"change_{m}", real=True) for m in rest}
        self._about = AboutRest({m: (sympy.Integer(v), self._change[m]) for m, v in rest.items()})
        psi = energy.psi_sigma if energy.needs_stretches else energy.psi
        self._psi = None if psi is None else fractions(psi)

    def energy_function(self) -> str:
        """psi from ``change``."""
        psi: sympy.Expr = sum(0.0 * c for c in self._change.values())
        if self._psi is not None:
            psi = sympy.Add(*self._about(self._psi))
        return self._function("energy_near_rest", {"psi[0]": psi}, "psi", "INFINITY")

    def gradient_function(self) -> str:
        """The principal stresses from the changes of the stretches."""
        results = {f"g[{i}]": sympy.Add(*self._about(p)) for i, p in enumerate(self.energy.slopes)}
        return self._function("gradient_near_rest", results, "g", "0")

    def stress_function(self) -> str:
        """The factors of stress_near_rest (small_strain.h) from the changes of the invariants."""
        (c, dc), (a, da), (j, dj) = (self._about(sympy.diff(self._psi, m)) for m in _INVARIANTS)
        factors = {
            # Summed here, what cancels at rest is gone.
            "factor[0]": sympy.simplify(2 * c + 4 * a + j) + (2 * dc + 4 * da + dj),
            "factor[1]": 2 * (c + dc),
            "factor[2]": 2 * (a + da),
            "factor[3]": j + dj,
        }
        return self._function("factors_near_rest", factors, "factor", "0")

    def _function(
        self, name: str, results: Mapping[str, sympy.Expr], out: str, outside: str
    ) -> str:
        lines = [self._c.constants()]
        for number, (m, change) in enumerate(self._change.items()):
            lines.append(f"  const real {change} = change[{number}];")
            rest = self._about(m)[0]
            lines.append(f"  const real {m} = {rest} + {change};")
        if self.energy.needs_stretches:
            lines.append(self._c.invariants())
        lines.append(statements(results, self.energy.constants, "n_"))
        lines.append("  " + self._c.inside(results, self.energy.domain))
        lines += [f"  {r} = select(inside, {r}, splat({outside}));" for r in results]
        head = f"INLINE void {name}(Law p, const real *change, real *{out})"
        return head + " {\n" + "\n".join(lines) + "\n}\n"
