"""Print sympy expressions as C statements on SIMD lanes (lanes.h)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import sympy
from sympy.printing.c import C99CodePrinter

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
        return f"lane_pow({lanes}, {self._exponent(exponent)})"

    def _print_Function(self, expr: sympy.Function) -> str:
        if expr.is_number:
            return repr(float(expr))
        # An argument may be a scalar; splat(0) + scalar is a lane.
        arguments = (f"splat(0) + {self._print(a)}" for a in expr.args)
        return f"lane_{expr.func.__name__}({', '.join(arguments)})"

    def _print_powm1_over_x(self, expr: sympy.Function) -> str:
        x, exponent = expr.args
        return f"lane_powm1_over_x(splat(0) + {self._print(x)}, {self._exponent(exponent)})"

    def _exponent(self, exponent: sympy.Expr) -> str:
        return repr(float(exponent)) if exponent.is_number else str(self._print(exponent))

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
    With symbols in the exponents, b^(n x + m) share that of b^x.
    """
    return expression.replace(
        lambda e: e.is_Pow and not e.exp.is_integer and not e.is_number, _with_shared_power
    )


def _with_shared_power(expression: sympy.Pow) -> sympy.Expr:
    base = expression.base
    number, rest = sympy.expand(expression.exp).as_coeff_Add()
    whole = sympy.floor(number)
    product = base**whole * (power(base, number - whole) if number != whole else 1)
    for term in sympy.Add.make_args(rest):
        if term != 0:
            factor, symbols = term.as_coeff_Mul()
            product *= power(base, symbols) ** factor if factor.is_Integer else power(base, term)
    return product


def statements(
    results: Mapping[str, sympy.Expr], scalars: Iterable[sympy.Symbol], temporary: str
) -> str:
    """Return C statements that assign each result, with common subexpressions eliminated.

    Parameters
    ----------
    results : mapping
        C variables (lanes) and the expressions assigned to them.
    scalars : iterable of sympy.Symbol
        Symbols that are scalars (the constants and shape parameters): subexpressions of these alone
        are computed once, as doubles.
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
        )  # the lane functions take lanes only
        scalar = expression.free_symbols <= known and not calls
        if scalar:
            known.add(symbol)
        kind = "double" if scalar else "real"
        lines.append(f"const {kind} {symbol} = {printer.doprint(expression)};")
    for target, expression in zip(results, expressions, strict=True):
        lines.append(f"{target} = splat(0) + {printer.doprint(expression)};")
    return "\n".join(f"  {line}" for line in lines)
