"""The C functions of one energy, in the invariants or the principal stretches.

material_point.h calls them. `small_strain` generates the same functions in a form that is accurate
at small strains; `source` joins both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import sympy

from fem_snh.kernels.codegen.derivatives import I_C, II_C, Derivatives, J
from fem_snh.kernels.codegen.printer import Printer, statements
from fem_snh.materials.functions import domain
from fem_snh.materials.invariants import INVARIANTS, SIGMA

#: Entries of the scaling block in the order of eigen3.h.
_BLOCK = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
#: The indices (j, k) of the stretches that twist i and flip i couple.
_PAIRS = ((1, 2), (0, 2), (0, 1))


class Functions(Derivatives):
    """Generator of the C functions of one energy. Every method returns C source."""

    def constants(self) -> str:
        """Return the declarations of the scalars and of the pressure."""
        lines = [
            f"  const double {c} = p.constants[{i}];" for i, c in enumerate(self.energy.scalars)
        ]
        if self.energy.pressure is not None:
            lines.append(f"  const real {self.energy.pressure} = p.pressure;")
        return "\n".join(lines)

    def measures(self, argument: str) -> str:
        """Return the computation of the measures from ``F`` or from the stretches ``s``."""
        if argument == "s":
            stretches = "\n".join(f"  const real s{i} = s[{i}];" for i in range(3))
            return f"{stretches}\n{self.invariants()}"
        lines = {
            I_C: "  const real I_C = dot(F, F) + dot(F + 3, F + 3) + dot(F + 6, F + 6);",
            II_C: "  const real II_C = dot(G, G) + dot(G + 3, G + 3) + dot(G + 6, G + 6);",
            J: "  const real J = dot(F, G);",
        }
        cofactor = (
            "  real G[9]; /* cof F = dJ/dF (Smith et al. 2018, eq. 19) */\n"
            "  cross(F + 3, F + 6, G);\n  cross(F + 6, F, G + 3);\n  cross(F, F + 3, G + 6);"
        )
        return "\n".join([cofactor, *(lines[m] for m in self.energy.measures)])

    def invariants(self) -> str:
        """Return the computation of the invariants among the measures from s0, s1, s2."""
        known = {f"const real {m}": INVARIANTS[m] for m in self.energy.measures if m in INVARIANTS}
        return statements(known, (), "m_")

    def inside(self, results: Iterable[str], domain: Iterable[sympy.Expr]) -> str:
        """Return the mask of the lanes inside a domain where all results are finite.

        Parameters
        ----------
        results : iterable of str
            C variables.
        domain : iterable of sympy.Expr
            Expressions that are positive inside the domain.
        """
        printer = Printer()
        tests = [f"({printer.doprint(x)} > 0)" for x in domain]
        size = " + ".join(f"absolute({r})" for r in results)
        return f"const mask inside = {' & '.join([*tests, f'({size} < INFINITY)'])};"

    def function(
        self,
        signature: str,
        argument: str,
        derivatives: Iterable[sympy.Symbol],
        results: Mapping[str, sympy.Expr],
        outside: str = "0",
    ) -> str:
        """Return one C function: constants, measures, derivatives of psi, results.

        Parameters
        ----------
        signature : str
            Name and arguments.
        argument : str
            ``"F"`` or ``"s"``.
        derivatives : iterable of sympy.Symbol
            The symbols of ``Derivatives.derivatives`` that the results contain.
        results : mapping
            C variables and the expressions assigned to them.
        outside : str
            Value of the results where psi is infinite or a result overflows; never NaN.
        """
        needed = {f"const real {s}": self.derivatives[s] for s in derivatives}
        body = [self.constants(), self.measures(argument)]
        if needed:
            body.append(statements(needed, self.energy.scalars, "d_"))
        body.append(statements(results, self.energy.scalars, "r_"))
        body.append(f"  {self.inside(results, self.energy.domain)}")
        body += [f"  {r} = select(inside, {r}, splat({outside}));" for r in results]
        return f"INLINE void {signature} {{\n" + "\n".join(body) + "\n}\n"

    def energy_function(self, argument: str) -> str:
        """Return the function of psi from ``F`` or from the stretches ``s``."""
        name = "energy_stretches" if argument == "s" else "energy_invariants"
        # A material without an energy has psi = 0; 0 s keeps what is not finite.
        psi = self.energy.psi if self.energy.has_energy else sum(0.0 * s for s in SIGMA)
        signature = f"{name}(Parameters p, const real *{argument}, real *psi)"
        return self.function(signature, argument, (), {"psi[0]": psi}, "INFINITY")

    def stress_function(self) -> str:
        """Return the function of P = 2 psi_C F + 2 psi_II (I_C F - F C) + psi_J cof F."""
        F = sympy.Matrix(3, 3, lambda i, j: sympy.Symbol(f"F[{3 * j + i}]"))
        G = sympy.Matrix(3, 3, lambda i, j: sympy.Symbol(f"G[{3 * j + i}]"))
        P = 2 * self.derivative(I_C) * F + self.derivative(J) * G
        if self.derivative(II_C) != 0:
            total = I_C if I_C in self.energy.measures else sum(f**2 for f in F)
            P += 2 * self.derivative(II_C) * (total * F - F * F.T * F)
        results = {f"P[{3 * j + i}]": P[i, j] for j in range(3) for i in range(3)}
        signature = "stress_invariants(Parameters p, const real *F, real *P)"
        return self.function(signature, "F", self.first.values(), results)

    def gradient_function(self) -> str:
        """Return the function of the principal stresses g_i = dpsi/ds_i."""
        results = {f"g[{i}]": self.principal_stress(s) for i, s in enumerate(SIGMA)}
        signature = "gradient_stretches(Parameters p, const real *s, real *g)"
        return self.function(signature, "s", self.first.values(), results)

    def hessian_function(self) -> str:
        """Return the function of the scaling block and the twist and flip eigenvalues."""
        results = {
            f"A[{n}]": self.second_derivative(SIGMA[i], SIGMA[j]) for n, (i, j) in enumerate(_BLOCK)
        }
        for i, (j, k) in enumerate(_PAIRS):
            twist, flip = self.twist_and_flip(SIGMA[i], SIGMA[j], SIGMA[k])
            results |= {f"twist[{i}]": twist, f"flip[{i}]": flip}
        arguments = "Parameters p, const real *s, real *A, real *twist, real *flip"
        return self.function(f"hessian_stretches({arguments})", "s", self.derivatives, results)

    def curve_function(
        self,
        signature: str,
        variable: sympy.Symbol,
        curve: Sequence[sympy.Expr],
        out: str,
        forms: Sequence[sympy.Expr] = (),
    ) -> str:
        """Return a C function of material_functions.h: a function of one variable, two derivatives.

        Outside its domain the function is infinite and its derivatives are 0.

        Parameters
        ----------
        signature : str
            Name and arguments.
        variable : sympy.Symbol
            The variable.
        curve : sequence of three sympy.Expr
            The function and its derivatives.
        out : str
            C array for the three values.
        forms : sequence of three sympy.Expr, optional
            The same expressions in a form with smaller rounding errors; written instead.
        """
        results = {f"{out}[{i}]": expression for i, expression in enumerate(forms or curve)}
        lines = [self.constants(), statements(results, self.energy.scalars, "c_")]
        lines.append("  " + self.inside(results, domain(curve, [variable])))
        outside = ("INFINITY", "0", "0")
        lines += [
            f"  {r} = select(inside, {r}, splat({o}));"
            for r, o in zip(results, outside, strict=True)
        ]
        return f"void {signature} {{\n" + "\n".join(lines) + "\n}\n"
