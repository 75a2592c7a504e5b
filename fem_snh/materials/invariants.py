"""The deformation measures in which energies are written, and functions besides sympy's own.

The measures are functions of the signed principal stretches:

``I1``   = sum sigma_i, the trace of the stretch tensor S (polar decomposition F = R S)
``I_C``  = sum sigma_i^2 = tr C
``II_C`` = (I_C^2 - tr C^2)/2 = sum of (sigma_i sigma_j)^2, the second invariant of C
``J``    = sigma_0 sigma_1 sigma_2 = det F
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import sympy
from sympy.codegen.cfunctions import log1p

#: The signed principal stretches of the rotation-variant SVD (Smith et al. 2018, eq. 2).
SIGMA = sympy.symbols("s0 s1 s2", real=True)

_s0, _s1, _s2 = SIGMA
_I1, _J = sympy.symbols("I1 J", real=True)
_I_C, _II_C = sympy.symbols("I_C II_C", nonnegative=True)

#: Each invariant's symbol and its expression in the stretches.
INVARIANTS: dict[sympy.Symbol, sympy.Expr] = {
    _I1: _s0 + _s1 + _s2,
    _I_C: _s0**2 + _s1**2 + _s2**2,
    _II_C: (_s0 * _s1) ** 2 + (_s0 * _s2) ** 2 + (_s1 * _s2) ** 2,
    _J: _s0 * _s1 * _s2,
}

#: The measures that a material function may have as arguments, by name.
MEASURES: dict[str, sympy.Symbol] = {str(m): m for m in (*INVARIANTS, *SIGMA)}


class Parameter(sympy.Symbol):  # type: ignore[misc]  # sympy has no annotations
    """The symbol of a shape parameter whose value a fit determines."""


def parameters_in(values: Iterable[object]) -> set[sympy.Symbol]:
    """Return the `Parameter` symbols in ``values``: expressions, or tuples of expressions."""
    found: set[sympy.Symbol] = set()
    for value in values:
        if isinstance(value, tuple | list):
            found |= parameters_in(value)
        elif isinstance(value, sympy.Basic):
            found |= value.atoms(Parameter)
    return found


#: A double is read as a fraction with at most this denominator if that fraction rounds to it.
_LARGEST_DENOMINATOR = 1000


class where(sympy.Function):
    """Piecewise expression ``where(x, a, b)``: a if x > 0, else b.

    Only the chosen piece has to be finite. The derivative is the derivative of the chosen piece, so
    the energy is differentiable at x = 0 if the values and derivatives of both pieces agree there.
    """

    nargs = (3,)

    @classmethod
    def eval(cls, x: sympy.Expr, a: sympy.Expr, b: sympy.Expr) -> sympy.Expr | None:
        if a == b:
            return a
        if x.is_number and x.is_comparable:
            return a if x > 0 else b
        return None

    def _eval_derivative(self, s: sympy.Symbol) -> sympy.Expr:
        x, a, b = self.args
        return where(x, sympy.diff(a, s), sympy.diff(b, s))

    def _eval_is_extended_real(self) -> bool:
        return True

    def _mpmathcode(self, printer: Any) -> str:
        x, a, b = map(printer.doprint, self.args)
        return f"(({a}) if ({x}) > 0 else ({b}))"


class positive(sympy.Function):
    """Barrier ``positive(x)`` = x; the energy is +inf where x <= 0.

    Energies use it at a singularity that a deformation must not cross, such as 1/J^2 at J = 0.
    """

    nargs = (1,)


@dataclass(frozen=True)
class PrincipalStress:
    """Principal PK1 stresses [Pa] of a material without an energy, as expressions in s0, s1, s2."""

    p0: sympy.Expr
    p1: sympy.Expr
    p2: sympy.Expr

    def __iter__(self) -> Iterator[sympy.Expr]:
        return iter((self.p0, self.p1, self.p2))


def domain(
    expressions: Iterable[sympy.Expr],
    measures: Iterable[sympy.Symbol],
    barriers: Iterable[sympy.Expr] = (),
) -> tuple[sympy.Expr, ...]:
    """Return the expressions that must be positive for all of ``expressions`` to be real.

    Parameters
    ----------
    expressions : iterable of sympy.Expr
        Energies or stresses. The pieces of a `where` are not searched.
    measures : iterable of sympy.Symbol
        Only expressions that depend on at least one of these symbols are returned.
    barriers : iterable of sympy.Expr
        Arguments of `positive`, which must be positive too.
    """
    mine = set(measures)
    bases = {b for b in barriers if _restricts(b, mine)}
    for expression in expressions:
        hidden = {w: sympy.Dummy(real=True) for w in expression.atoms(where)}
        shown = {dummy: w for w, dummy in hidden.items()}
        expression = expression.xreplace(hidden)
        found = {a.args[0] for a in expression.atoms(sympy.log)}
        found |= {1 + a.args[0] for a in expression.atoms(log1p)}
        found |= {p.base for p in expression.atoms(sympy.Pow) if not p.exp.is_integer}
        bases |= {base.xreplace(shown) for base in found if _restricts(base, mine)}
    return tuple(sorted(bases, key=str))


def _restricts(base: sympy.Expr, measures: set[sympy.Symbol]) -> bool:
    """Return True if the expression depends on a measure and is not positive for every value."""
    return bool(base.free_symbols & measures) and not base.is_positive


def exact(parameter: object) -> sympy.Expr:
    """Return a number as the fraction of its decimal digits, 0.1 as 1/10; a symbol unchanged."""
    written = isinstance(parameter, int | float)
    return sympy.Rational(str(parameter)) if written else sympy.sympify(parameter)


def fractions(expression: sympy.Expr) -> sympy.Expr:
    """Return the expression with each float replaced by the simplest fraction that rounds to it.

    1/30.0 becomes 1/30, so that 1 - 30 (1/30.0) is exactly 0.
    """
    return expression.xreplace({x: _fraction(x) for x in expression.atoms(sympy.Float)})


def _fraction(number: sympy.Float) -> sympy.Rational:
    fraction = sympy.Rational(number)
    simple = fraction.limit_denominator(_LARGEST_DENOMINATOR)
    return simple if float(simple) == float(number) else fraction
