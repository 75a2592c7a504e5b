"""What an energy may be written with besides sympy's own functions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import sympy

#: The largest denominator that somebody may have meant.
_SIMPLE = 1000


class where(sympy.Function):
    """``where(x, a, b)``: a if x > 0, else b; only the chosen one has to be finite.

    For energies and stresses in pieces. Its derivative is that of the chosen piece, so the pieces
    must meet as smoothly as the energy is to be.
    """

    nargs = (3,)

    @classmethod
    def eval(cls, x: Any, a: Any, b: Any) -> Any:
        if a == b:
            return a
        if x.is_number and x.is_comparable:
            return a if x > 0 else b
        return None

    def _eval_derivative(self, s: Any) -> Any:
        x, a, b = self.args
        return where(x, sympy.diff(a, s), sympy.diff(b, s))

    def _eval_is_extended_real(self) -> bool:
        return True

    def _mpmathcode(self, printer: Any) -> str:
        x, a, b = map(printer.doprint, self.args)
        return f"(({a}) if ({x}) > 0 else ({b}))"


class positive(sympy.Function):
    """``positive(x)`` = x, and the energy is +inf where x <= 0.

    For energies that are finite beyond a singularity they must not cross, such as 1/J^2.
    """

    nargs = (1,)


@dataclass(frozen=True)
class PrincipalStress:
    """Principal PK1 stresses [Pa] in s0, s1, s2, of a material that has no energy."""

    p0: Any
    p1: Any
    p2: Any

    def __iter__(self) -> Any:
        return iter((self.p0, self.p1, self.p2))


def pieces_hidden(expression: sympy.Expr) -> sympy.Expr:
    """The expression with every `where` replaced by a symbol: what counts everywhere."""
    hidden = {w: sympy.Dummy(real=True) for w in expression.atoms(where)}
    return expression.xreplace(hidden)


def domain(
    expressions: Iterable[sympy.Expr],
    measures: Iterable[sympy.Symbol],
    barriers: Iterable[sympy.Expr] = (),
) -> tuple[sympy.Expr, ...]:
    """What must be positive for all expressions to be real; see `Energy.domain`."""
    bases, mine = set(barriers), set(measures)
    for expression in map(pieces_hidden, expressions):
        bases |= {a.args[0] for a in expression.atoms(sympy.log)}
        bases |= {p.base for p in expression.atoms(sympy.Pow) if not p.exp.is_integer}
    return tuple(sorted((b for b in bases if b.free_symbols & mine and not b.is_positive), key=str))


def exact(parameter: Any) -> sympy.Expr:
    """A parameter as the decimal fraction that it is written as; a symbol is itself."""
    written = isinstance(parameter, int | float)
    return sympy.Rational(str(parameter)) if written else sympy.sympify(parameter)


def fractions(expression: sympy.Expr) -> sympy.Expr:
    """The expression with its floats as fractions: the simple one that was meant, if there is.

    1/30.0 is 1/30, so that 1 - 30 (1/30.0) is 0; to a float they are the same.
    """
    return expression.xreplace({x: _fraction(x) for x in expression.atoms(sympy.Float)})


def _fraction(number: sympy.Float) -> sympy.Rational:
    fraction = sympy.Rational(number)
    simple = fraction.limit_denominator(_SIMPLE)
    return simple if float(simple) == float(number) else fraction
