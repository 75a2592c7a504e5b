"""Generate the C functions of one energy at small strains, in terms of increments.

material_point.h calls them with the increments that small_strain.h computes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy

from fem_snh.kernels.codegen.c_functions import Functions
from fem_snh.kernels.codegen.derivatives import I_C, II_C, J
from fem_snh.kernels.codegen.increments import Increments
from fem_snh.kernels.codegen.printer import statements
from fem_snh.materials.energy import Energy
from fem_snh.materials.functions import fractions, where
from fem_snh.materials.invariants import SIGMA

#: Values at rest of the measures whose increments small_strain.h computes, in its order.
_INVARIANTS_AT_REST = {I_C: 3, II_C: 3, J: 1}
_STRETCHES_AT_REST = dict.fromkeys(SIGMA, 1)

#: The increment J - 1 of a cell's mean volume ratio.
VOLUME_INCREMENT = sympy.Symbol("change", real=True)
#: The small-strain form is used below this |J - 1|, where both forms are accurate to double
#: precision.
_SMALL_VOLUME_CHANGE = sympy.Rational(1, 4)


def small_strain_forms(curve: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """Return expressions in J in a form that is accurate where J - 1 is small.

    Parameters
    ----------
    curve : sequence of sympy.Expr
        Expressions in J; the results are in J and VOLUME_INCREMENT.
    """
    increments = Increments({J: (sympy.Integer(1), VOLUME_INCREMENT)})
    small = _SMALL_VOLUME_CHANGE - sympy.Abs(VOLUME_INCREMENT)
    return [where(small, sympy.Add(*increments(f)), f) for f in curve]


class SmallStrainFunctions:
    """Generator of the C functions of energy and stress at small strains.

    The arguments of the C functions are increments from rest: of the stretches for an energy that
    needs them, otherwise of the invariants. Every method returns C source.

    Parameters
    ----------
    energy : Energy
        A normalised energy.
    """

    def __init__(self, energy: Energy) -> None:
        self.energy = energy
        self._c = Functions(energy)
        rest = _STRETCHES_AT_REST if energy.needs_stretches else _INVARIANTS_AT_REST
        self._change = {m: sympy.Symbol(f"change_{m}", real=True) for m in rest}
        self._split = Increments({m: (sympy.Integer(v), self._change[m]) for m, v in rest.items()})
        psi = energy.psi_sigma if energy.needs_stretches else energy.psi
        self._psi = None if psi is None else fractions(psi)

    def energy_function(self) -> str:
        """Return the function of psi; 0 for a material without an energy."""
        psi: sympy.Expr = sum(0.0 * c for c in self._change.values())
        if self._psi is not None:
            psi = sympy.Add(*self._split(self._psi))
        return self._function("energy_small_strain", {"psi[0]": psi}, "psi", "INFINITY")

    def gradient_function(self) -> str:
        """Return the function of the principal stresses."""
        results = {f"g[{i}]": sympy.Add(*self._split(p)) for i, p in enumerate(self.energy.slopes)}
        return self._function("gradient_small_strain", results, "g", "0")

    def stress_function(self) -> str:
        """Return the function of the four factors of small_strain_stress (small_strain.h)."""
        (c, dc), (a, da), (j, dj) = (
            self._split(sympy.diff(self._psi, m)) for m in _INVARIANTS_AT_REST
        )
        factors = {
            # The values at rest are summed symbolically, where they cancel exactly.
            "factor[0]": sympy.simplify(2 * c + 4 * a + j) + (2 * dc + 4 * da + dj),
            "factor[1]": 2 * (c + dc),
            "factor[2]": 2 * (a + da),
            "factor[3]": j + dj,
        }
        return self._function("stress_factors_small_strain", factors, "factor", "0")

    def _function(
        self, name: str, results: Mapping[str, sympy.Expr], out: str, outside: str
    ) -> str:
        """Return a C function from increments to ``results``: ``outside`` outside the domain."""
        lines = [self._c.constants()]
        for number, (m, change) in enumerate(self._change.items()):
            lines.append(f"  const real {change} = change[{number}];")
            rest = self._split(m)[0]
            lines.append(f"  const real {m} = {rest} + {change};")
        if self.energy.needs_stretches:
            lines.append(self._c.invariants())
        lines.append(statements(results, self.energy.scalars, "n_"))
        lines.append("  " + self._c.inside(results, self.energy.domain))
        lines += [f"  {r} = select(inside, {r}, splat({outside}));" for r in results]
        signature = f"INLINE void {name}(Parameters p, const real *change, real *{out})"
        return signature + " {\n" + "\n".join(lines) + "\n}\n"
