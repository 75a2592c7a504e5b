"""Generate the C functions of one energy, in the invariants or the principal stretches.

material_point.h calls these functions. `small_strain` generates versions that are accurate at small
strains; `source` joins both. The generated statements work on SIMD lanes (lanes.h).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import sympy
from sympy.printing.c import C99CodePrinter

from fem_snh.kernels.codegen.derivatives import I_C, II_C, Derivatives, J
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import INVARIANTS, SIGMA, domain

#: Largest int of C.
_INT_MAX = 2**31 - 1


class power(sympy.Function):
    """The power b^e in a form that sympy does not merge with other powers of b."""

    nargs = (2,)


class Printer(C99CodePrinter):  # type: ignore[misc]  # sympy has no annotations
    """Printer of lane expressions: integer powers as products, functions as ``lane_name``."""

    def _print_Pow(self, expr: sympy.Pow) -> str:
        if expr.is_number:  # a scalar, which no function of lanes takes
            return repr(float(expr))
        base, exponent = expr.args
        if exponent.is_Integer:
            product = "*".join([self.parenthesize(base, 100)] * abs(int(exponent)))
            return f"({product})" if exponent > 0 else f"(1/({product}))"
        return f"({self._print(share_fractional_powers(expr))})"

    def _print_Abs(self, expr: sympy.Abs) -> str:
        return f"absolute(splat(0) + {self._print(expr.args[0])})"

    def _print_sign(self, expr: sympy.sign) -> str:
        return f"lane_where(splat(0) + {self._print(expr.args[0])}, splat(1), splat(-1))"

    def _print_power(self, expr: sympy.Function) -> str:
        base, exponent = expr.args
        lanes = f"splat(0) + {self._print(base)}"
        if exponent == sympy.Rational(1, 2):
            return f"lane_sqrt({lanes})"
        return f"lane_pow({lanes}, {float(exponent)!r})"

    def _print_Function(self, expr: sympy.Function) -> str:
        if expr.is_number:
            return repr(float(expr))
        # An argument may be a scalar; splat(0) + scalar is a lane.
        arguments = (f"splat(0) + {self._print(a)}" for a in expr.args)
        return f"lane_{expr.func.__name__}({', '.join(arguments)})"

    def _print_powm1_over_x(self, expr: sympy.Function) -> str:
        x, exponent = expr.args
        return f"lane_powm1_over_x(splat(0) + {self._print(x)}, {float(exponent)!r})"

    _print_log1p = _print_expm1 = _print_Function
    _print_log = _print_exp = _print_sqrt = _print_cbrt = _print_Function

    def _print_Integer(self, expr: sympy.Integer) -> str:
        # C has no vector operation with a long int.
        return str(int(expr)) if abs(expr) <= _INT_MAX else repr(float(expr))

    def _print_Rational(self, expr: sympy.Rational) -> str:
        return repr(float(expr))


def share_fractional_powers(expression: sympy.Expr) -> sympy.Expr:
    """Return the expression with real powers b^e written b^n power(b, e - n), n = floor(e).

    An energy in s^e has derivatives in s^(e-1) and s^(e-2); all three then share one call of pow.
    """
    return expression.replace(
        lambda e: e.is_Pow and not e.exp.is_integer and not e.is_number, _with_shared_power
    )


def _with_shared_power(expression: sympy.Pow) -> sympy.Expr:
    base, exponent = expression.args
    whole = sympy.floor(exponent)
    return base**whole * power(base, exponent - whole)


def statements(
    results: Mapping[str, sympy.Expr], scalars: Iterable[sympy.Symbol], temporary: str
) -> str:
    """Return C statements that assign each result, with common subexpressions eliminated.

    Parameters
    ----------
    results : mapping
        C variables (lanes) and the expressions assigned to them.
    scalars : iterable of sympy.Symbol
        Symbols of doubles (the constants). Subexpressions of these symbols alone are doubles.
    temporary : str
        Prefix of the names of the subexpressions.
    """
    printer = Printer()
    temporaries, expressions = sympy.cse(
        [share_fractional_powers(sympy.sympify(e)) for e in results.values()],
        symbols=sympy.numbered_symbols(temporary),
    )
    known, lines = set(scalars), []
    for symbol, expression in temporaries:
        calls = any(
            f.free_symbols for f in expression.atoms(sympy.Function)
        )  # the C functions take lanes only
        scalar = expression.free_symbols <= known and not calls
        if scalar:
            known.add(symbol)
        kind = "double" if scalar else "real"
        lines.append(f"const {kind} {symbol} = {printer.doprint(expression)};")
    for target, expression in zip(results, expressions, strict=True):
        lines.append(f"{target} = splat(0) + {printer.doprint(expression)};")
    return "\n".join(f"  {line}" for line in lines)


#: Entries (row, column) of the scaling block in the order of eigen3.h.
_BLOCK = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
#: For each i, the indices (j, k) of the stretches that twist i and flip i couple.
_PAIRS = ((1, 2), (0, 2), (0, 1))


class Writer:
    """Write C functions of one energy: constants, results, domain. The methods return C source.

    Parameters
    ----------
    energy : Energy
        A normalised energy.
    """

    def __init__(self, energy: Energy) -> None:
        self.energy = energy

    def constants(self) -> str:
        """Return the declarations of the constants and, if psi contains it, of the pressure."""
        lines = [
            f"  const double {c} = p.constants[{i}];" for i, c in enumerate(self.energy.constants)
        ]
        if self.energy.pressure is not None:
            lines.append(f"  const real {self.energy.pressure} = p.pressure;")
        return "\n".join(lines)

    def invariants(self) -> str:
        """Return statements that compute the energy's invariants from s0, s1, s2."""
        known = {f"const real {m}": INVARIANTS[m] for m in self.energy.measures if m in INVARIANTS}
        return statements(known, (), "m_")

    def inside(self, results: Iterable[str], domain: Iterable[sympy.Expr]) -> str:
        """Return the statement of the mask ``inside``: in the domain, with finite results.

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

    def write(
        self,
        head: str,
        lines: Iterable[str],
        results: Mapping[str, sympy.Expr],
        temporary: str,
        outside: str = "0",
        limits: Iterable[sympy.Expr] | None = None,
    ) -> str:
        """Return a C function that declares the constants and assigns the results.

        Parameters
        ----------
        head : str
            Type, name and arguments.
        lines : iterable of str
            Statements between the constants and the results.
        results : mapping
            C variables and the expressions assigned to them.
        temporary : str
            Prefix of the names of subexpressions.
        outside : str
            Value of the first result outside the domain or where a result overflows; the other
            results are 0 there.
        limits : iterable of sympy.Expr, optional
            Expressions that are positive inside the domain; by default the energy's domain.
        """
        limits = self.energy.domain if limits is None else limits
        values = dict.fromkeys(results, "0") | {next(iter(results)): outside}
        body = [
            self.constants(),
            *lines,
            statements(results, self.energy.constants, temporary),
            f"  {self.inside(results, limits)}",
            *(f"  {r} = select(inside, {r}, splat({value}));" for r, value in values.items()),
        ]
        return f"{head} {{\n" + "\n".join(body) + "\n}\n"

    def curve_function(
        self,
        signature: str,
        variable: sympy.Symbol,
        curve: Sequence[sympy.Expr],
        out: str,
        forms: Sequence[sympy.Expr] = (),
    ) -> str:
        """Return a C function for the value and two derivatives of a function of one variable.

        Outside the function's domain the value is infinite and the derivatives are 0.

        Parameters
        ----------
        signature : str
            Name and arguments, as in material_functions.h.
        variable : sympy.Symbol
            The variable.
        curve : sequence of three sympy.Expr
            The function and its derivatives. They determine the domain.
        out : str
            C array for the three results.
        forms : sequence of three sympy.Expr, optional
            The expressions to write, if other forms than ``curve`` have smaller rounding errors.
        """
        results = {f"{out}[{i}]": expression for i, expression in enumerate(forms or curve)}
        limits = domain(curve, [variable])
        return self.write(f"void {signature}", [], results, "c_", "INFINITY", limits)


class Functions(Derivatives, Writer):
    """Generate the C functions of one energy. Every method returns C source."""

    def measures(self, argument: str) -> str:
        """Return statements that compute the measures from ``F`` or from the stretches ``s``."""
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
            As for `Writer.write`.
        """
        needed = {f"const real {s}": self.derivatives[s] for s in derivatives}
        lines = [self.measures(argument)]
        if needed:
            lines.append(statements(needed, self.energy.constants, "d_"))
        return self.write(f"INLINE void {signature}", lines, results, "r_", outside)

    def energy_function(self, argument: str) -> str:
        """Return the function of psi; ``argument`` is ``"F"`` or ``"s"``, the stretches."""
        name = "energy_stretches" if argument == "s" else "energy_invariants"
        # A material without an energy has psi = 0; `write` turns a 0 s that is NaN into +inf.
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
        """Return the function of the scaling block A and the twist and flip eigenvalues."""
        results = {
            f"A[{n}]": self.second_derivative(SIGMA[i], SIGMA[j]) for n, (i, j) in enumerate(_BLOCK)
        }
        for i, (j, k) in enumerate(_PAIRS):
            twist, flip = self.twist_and_flip(SIGMA[i], SIGMA[j], SIGMA[k])
            results |= {f"twist[{i}]": twist, f"flip[{i}]": flip}
        arguments = "Parameters p, const real *s, real *A, real *twist, real *flip"
        return self.function(f"hessian_stretches({arguments})", "s", self.derivatives, results)
