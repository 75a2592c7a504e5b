"""C functions of one energy, in the invariants or the stretches (called by material_point.h)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import sympy

from fem_snh.kernels.codegen.derivatives import I_C, II_C, Derivatives, J
from fem_snh.kernels.codegen.printer import Printer, statements
from fem_snh.materials.functions import domain
from fem_snh.materials.invariants import INVARIANTS, SIGMA

#: The scaling block's six entries in the order of eigen3.h.
_BLOCK = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
#: The stretches (s_j, s_k) that twist and flip i couple.
_COUPLED = ((1, 2), (0, 2), (0, 1))


class Functions(Derivatives):
    """The C functions of one energy."""

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
            return f"{stretches}\n{self.invariants()}"
        lines = {
            I_C: "  const real I_C = dot(F, F) + dot(F + 3, F + 3) + dot(F + 6, F + 6);",
            II_C: "  const real II_C = dot(G, G) + dot(G + 3, G + 3) + dot(G + 6, G + 6);",
            J: "  const real J = dot(F, G);",
        }
        cofactor = (
            "  real G[9]; /* dJ/dF (paper, eq. 19) */\n"
            "  cross(F + 3, F + 6, G);\n  cross(F + 6, F, G + 3);\n  cross(F, F + 3, G + 6);"
        )
        return "\n".join([cofactor, *(lines[m] for m in self.energy.measures)])

    def invariants(self) -> str:
        """C that computes the invariants among the measures from s0, s1, s2."""
        known = {f"const real {m}": INVARIANTS[m] for m in self.energy.measures if m in INVARIANTS}
        return statements(known, (), "m_")

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
        P = 2 * self.d(I_C) * F + self.d(J) * G
        if self.d(II_C) != 0:
            total = I_C if I_C in self.energy.measures else sum(f**2 for f in F)
            P += 2 * self.d(II_C) * (total * F - F * F.T * F)
        results = {f"P[{3 * j + i}]": P[i, j] for j in range(3) for i in range(3)}
        head = "stress_invariants(Law p, const real *F, real *P)"
        return self.function(head, "F", self.first.values(), results)

    def gradient_function(self) -> str:
        results = {f"g[{i}]": self.slope(s) for i, s in enumerate(SIGMA)}
        head = "gradient_stretches(Law p, const real *s, real *g)"
        return self.function(head, "s", self.first.values(), results)

    def hessian_function(self) -> str:
        results = {f"A[{n}]": self.curvature(SIGMA[i], SIGMA[j]) for n, (i, j) in enumerate(_BLOCK)}
        for i, (j, k) in enumerate(_COUPLED):
            twist, flip = self.pair(SIGMA[i], SIGMA[j], SIGMA[k])
            results |= {f"twist[{i}]": twist, f"flip[{i}]": flip}
        head = "hessian_stretches(Law p, const real *s, real *A, real *twist, real *flip)"
        return self.function(head, "s", self.derivatives, results)

    def curve_function(
        self,
        head: str,
        variable: sympy.Symbol,
        curve: Sequence[sympy.Expr],
        out: str,
        written: Sequence[sympy.Expr] = (),
    ) -> str:
        """One C function: a curve in one variable and its two derivatives.

        Outside its domain it is infinite, and its derivatives 0. ``written``: the same, otherwise.
        """
        results = {f"{out}[{i}]": expression for i, expression in enumerate(written or curve)}
        lines = [self.constants(), statements(results, self.energy.constants, "c_")]
        lines.append("  " + self.inside(results, domain(curve, [variable])))
        outside = ("INFINITY", "0", "0")
        lines += [
            f"  {r} = select(inside, {r}, splat({o}));"
            for r, o in zip(results, outside, strict=True)
        ]
        return f"INLINE void {head} {{\n" + "\n".join(lines) + "\n}\n"
