"""C for one material: its expression and derivatives, in the invariants or the stretches.

The closed forms (paper, eq. 42-48 for I_C and J; here for every isotropic energy):

scaling block   A_ij = d2psi/ds_i ds_j
twist_i         (psi_j + psi_k) / (s_j + s_k)      antisymmetric eigenmatrix D_3+i
flip_i          (psi_j - psi_k) / (s_j - s_k)      symmetric eigenmatrix D_6+i

An energy of the invariants needs no such division (psi_m = dpsi/dI_m):

twist_i = 2 psi_1/(s_j + s_k) + 2 psi_C + psi_II (2 I_C - 2 (s_j^2 - s_j s_k + s_k^2)) + s_i psi_J
flip_i  =                       2 psi_C + psi_II (2 I_C - 2 (s_j^2 + s_j s_k + s_k^2)) - s_i psi_J
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from itertools import combinations_with_replacement

import sympy

from fem_snh.kernels.printer import Printer, statements
from fem_snh.materials.energy import Energy, domain
from fem_snh.materials.invariants import INVARIANTS, SIGMA
from fem_snh.materials.split import PRESSURE, Split
from fem_snh.materials.split import J as _VOLUME

_I1, _I_C, _II_C, _J = INVARIANTS
#: The scaling block's six entries in the order of eigen3.h.
_BLOCK = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
#: The stretches (s_j, s_k) that twist and flip i couple.
_COUPLED = ((1, 2), (0, 2), (0, 1))
#: The parts of the C source, in order; the generated code goes before "point.h".
_BEFORE, _AFTER = ("lanes.h", "svd.h", "eigen3.h"), ("point.h", "point_api.h")
_TOOLS = (*_BEFORE, "tools_api.h")


class _Generator:
    """The C functions of one energy (see point.h for what they are called for)."""

    def __init__(self, energy: Energy) -> None:
        self.energy = energy
        #: First and second derivatives of psi in its measures; zeros are left out.
        self.first: dict[sympy.Symbol, sympy.Symbol] = {}
        self.second: dict[tuple[sympy.Symbol, sympy.Symbol], sympy.Symbol] = {}
        self.derivatives: dict[sympy.Symbol, sympy.Expr] = {}
        if energy.of_stretches:
            slopes = dict(zip(SIGMA, energy.slopes, strict=True))
            for s in SIGMA:
                self._add(self.first, s, f"psi_{s}", slopes[s])
            for s, t in combinations_with_replacement(SIGMA, 2):
                # The symmetric part: of a stress that is no gradient there is no other matrix.
                derivative = sympy.diff(slopes[s], t)
                if not energy.has_energy:
                    derivative = (derivative + sympy.diff(slopes[t], s)) / 2
                self._add(self.second, (s, t), f"psi_{s}_{t}", derivative)
            return
        for m in energy.measures:
            self._add(self.first, m, f"psi_{m}", sympy.simplify(sympy.diff(energy.psi, m)))
        for m, n in combinations_with_replacement(energy.measures, 2):
            second = sympy.simplify(sympy.diff(energy.psi, m, n))
            self._add(self.second, (m, n), f"psi_{m}_{n}", second)

    def _add(self, table: dict, key: object, name: str, expression: sympy.Expr) -> None:
        if expression != 0:
            table[key] = sympy.Symbol(name)
            self.derivatives[table[key]] = expression

    def d(self, *measures: sympy.Symbol) -> sympy.Expr:
        """The symbol of a derivative of psi, or 0 where it vanishes identically."""
        if len(measures) == 1:
            return self.first.get(measures[0], sympy.Integer(0))
        m, n = sorted(measures, key=self.energy.measures.index)
        return self.second.get((m, n), sympy.Integer(0))

    def constants(self) -> str:
        lines = [
            f"  const double {c} = p.constants[{i}];" for i, c in enumerate(self.energy.constants)
        ]
        if self.energy.pressure is not None:
            lines.append(f"  const real {self.energy.pressure} = p.pressure;")
        return "\n".join(lines)

    def measures_of(self, source: str) -> str:
        """C that computes the measures from ``F`` or from ``s``."""
        if source == "s":
            stretches = "\n".join(f"  const real s{i} = s[{i}];" for i in range(3))
            invariants = {
                f"const real {m}": INVARIANTS[m] for m in self.energy.measures if m in INVARIANTS
            }
            return stretches + ("\n" + statements(invariants, (), "m_") if invariants else "")
        lines = {
            _I_C: "  const real I_C = dot(F, F) + dot(F + 3, F + 3) + dot(F + 6, F + 6);",
            _II_C: "  const real II_C = dot(G, G) + dot(G + 3, G + 3) + dot(G + 6, G + 6);",
            _J: "  const real J = dot(F, G);",
        }
        cofactor = (
            "  real G[9]; /* dJ/dF (paper, eq. 19) */\n"
            "  cross(F + 3, F + 6, G);\n  cross(F + 6, F, G + 3);\n  cross(F, F + 3, G + 6);"
        )
        return "\n".join([cofactor, *(lines[m] for m in self.energy.measures)])

    def inside(self, results: Iterable[str], domain: Iterable[sympy.Expr]) -> str:
        """C for the mask of lanes in a domain, and in that of floating point."""
        printer = Printer()
        tests = [f"({printer.doprint(x)} > 0)" for x in domain]
        size = " + ".join(f"absolute({r})" for r in results)
        return f"const mask inside = {' & '.join([*tests, f'({size} < INFINITY)'])};"

    def function(
        self,
        head: str,
        source: str,
        derivatives: Iterable[sympy.Symbol],
        results: Mapping[str, sympy.Expr],
        outside: str = "0",
    ) -> str:
        """One C function: constants, measures, the derivatives it needs, results.

        Where psi is infinite, or one of them overflows, they are ``outside``: never NaN.
        """
        needed = {f"const real {s}": self.derivatives[s] for s in derivatives}
        body = [self.constants(), self.measures_of(source)]
        if needed:
            body.append(statements(needed, self.energy.constants, "d_"))
        body.append(statements(results, self.energy.constants, "r_"))
        body.append(f"  {self.inside(results, self.energy.domain)}")
        body += [f"  {r} = select(inside, {r}, splat({outside}));" for r in results]
        return f"INLINE void {head} {{\n" + "\n".join(body) + "\n}\n"

    def energy_function(self, source: str) -> str:
        name = "energy_stretches" if source == "s" else "energy_invariants"
        return self.function(
            f"{name}(Law p, const real *{source}, real *psi)",
            source,
            (),
            # Without an energy it is 0 where there is a stress: what is not finite stays so.
            {"psi[0]": self.energy.psi if self.energy.has_energy else sum(0.0 * s for s in SIGMA)},
            "INFINITY",
        )

    def stress_function(self) -> str:
        """P = 2 psi_C F + psi_II (2 I_C F - 2 F C) + psi_J cof F for energies without stretches."""
        F = sympy.Matrix(3, 3, lambda i, j: sympy.Symbol(f"F[{3 * j + i}]"))
        G = sympy.Matrix(3, 3, lambda i, j: sympy.Symbol(f"G[{3 * j + i}]"))
        P = 2 * self.d(_I_C) * F + self.d(_J) * G
        if self.d(_II_C) != 0:
            I_C = _I_C if _I_C in self.energy.measures else sum(f**2 for f in F)
            P += 2 * self.d(_II_C) * (I_C * F - F * F.T * F)
        results = {f"P[{3 * j + i}]": P[i, j] for j in range(3) for i in range(3)}
        head = "stress_invariants(Law p, const real *F, real *P)"
        return self.function(head, "F", self.first.values(), results)

    def gradient_function(self) -> str:
        results = {f"g[{i}]": self.slope(s) for i, s in enumerate(SIGMA)}
        head = "gradient_stretches(Law p, const real *s, real *g)"
        return self.function(head, "s", self.first.values(), results)

    def slope(self, s: sympy.Symbol) -> sympy.Expr:
        """dpsi/ds by the chain rule over the measures."""
        if self.energy.of_stretches:
            return self.d(s)
        return sum(self.d(m) * sympy.diff(INVARIANTS[m], s) for m in self.energy.measures)

    def curvature(self, s: sympy.Symbol, t: sympy.Symbol) -> sympy.Expr:
        """d2psi/ds dt by the chain rule over the measures."""
        if self.energy.of_stretches:
            return self.d(s, t)
        measures = self.energy.measures
        total = sum(self.d(m) * sympy.diff(INVARIANTS[m], s, t) for m in measures)
        for m in measures:
            for n in measures:
                ds, dt = sympy.diff(INVARIANTS[m], s), sympy.diff(INVARIANTS[n], t)
                total += self.d(m, n) * ds * dt
        return sympy.sympify(total)

    def hessian_function(self) -> str:
        results = {f"A[{n}]": self.curvature(SIGMA[i], SIGMA[j]) for n, (i, j) in enumerate(_BLOCK)}
        for i, (j, k) in enumerate(_COUPLED):
            twist, flip = self.pair(SIGMA[i], SIGMA[j], SIGMA[k])
            results |= {f"twist[{i}]": twist, f"flip[{i}]": flip}
        head = "hessian_stretches(Law p, const real *s, real *A, real *twist, real *flip)"
        return self.function(head, "s", self.derivatives, results)

    def pair(
        self, si: sympy.Symbol, sj: sympy.Symbol, sk: sympy.Symbol
    ) -> tuple[sympy.Expr, sympy.Expr]:
        """twist_i and flip_i (module docstring); divided differences take their limits in C."""
        if self.energy.of_stretches:
            pj, pk, pjj, pkk, pjk = (
                self.slope(sj),
                self.slope(sk),
                self.curvature(sj, sj),
                self.curvature(sk, sk),
                self.curvature(sj, sk),
            )
            mean = (pjj + pkk) / 2
            twist = sympy.Function("quotient")(pj + pk, sj + sk, sj - sk, mean + pjk)
            flip = sympy.Function("quotient")(pj - pk, sj - sk, sj + sk, mean - pjk)
            return twist, flip
        common = 2 * self.d(_I_C)
        area = 2 * self.d(_II_C)
        I_C = sum(s**2 for s in SIGMA)
        twist = common + area * (I_C - (sj**2 - sj * sk + sk**2)) + si * self.d(_J)
        flip = common + area * (I_C - (sj**2 + sj * sk + sk**2)) - si * self.d(_J)
        if self.d(_I1) != 0:
            twist += 2 * self.d(_I1) * sympy.Function("inverse_sum")(sj, sk)
        return twist, flip

    def curve_function(
        self, head: str, variable: sympy.Symbol, curve: Sequence[sympy.Expr], out: str
    ) -> str:
        """One C function: a curve in one variable and its two derivatives.

        Outside its domain it is infinite, and its derivatives 0.
        """
        results = {f"{out}[{i}]": expression for i, expression in enumerate(curve)}
        lines = [self.constants(), statements(results, self.energy.constants, "c_")]
        lines.append("  " + self.inside(results, domain(curve, [variable])))
        outside = ("INFINITY", "0", "0")
        lines += [
            f"  {r} = select(inside, {r}, splat({o}));"
            for r, o in zip(results, outside, strict=True)
        ]
        return f"INLINE void {head} {{\n" + "\n".join(lines) + "\n}\n"


def volume_curve(split: Split) -> str:
    """C for U(J), U', U'' of a material (volume_mean.h)."""
    head = "volume_curve(Law p, real J, real *U)"
    return _Generator(split.law).curve_function(head, _VOLUME, split.volume_curve, "U")


def volume_dual(split: Split) -> str:
    """C for U*(p), J(p), dJ/dp of a material (volume_pressure.h)."""
    head = "volume_dual(Law p, real *dual)"
    return _Generator(split.law).curve_function(head, PRESSURE, split.dual_curve, "dual")


def tools() -> str:
    """The C source of what knows no material: the SVD and the eigensolvers."""
    folder = files(__package__)
    return "\n".join(["#include <math.h>", *((folder / name).read_text() for name in _TOOLS)])


def source(
    energy: Energy,
    before: Sequence[str] = (),
    after: Sequence[str] = (),
    functions: Sequence[str] = (),
) -> str:
    """The whole C source for ``energy``: headers, generated functions, then the files ``after``.

    ``before`` are lines put at the top (the sizes of an element, say), ``functions`` C that goes
    before the files.
    """
    g = _Generator(energy)
    generated = [g.energy_function("s"), g.gradient_function(), g.hessian_function()]
    if not energy.needs_stretches:
        generated += [g.energy_function("F"), g.stress_function()]
    folder = files(__package__)
    return "\n".join(
        [
            "#include <math.h>",
            *before,
            f"#define NEEDS_STRETCHES {int(energy.needs_stretches)}",
            *((folder / name).read_text() for name in (*_BEFORE, "quotient.h", "law.h")),
            f"/* generated: {energy.name}, psi = {energy.psi} */",
            *generated,
            *functions,
            *((folder / name).read_text() for name in (*_AFTER, *after)),
        ]
    )
