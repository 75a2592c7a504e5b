"""Expressions near rest: their values at rest, and what is added to them, without cancellation.

Of each part f of an expression the pair (f0, df) is kept, f = f0 + df: f0 exactly, of constants
alone, and df in the changes of the measures (J - 1, I_C - 3, s_i - 1), which the kernels know to a
rounding of their own size (small_strain.h). Sums of f0 cancel here, exactly; in df there is nothing
left to cancel that is larger than the strain::

    f + g     df + dg                         log f   log1p(df/f0)
    f g       f0 dg + df (g0 + dg)            exp f   exp(f0) expm1(df)
    f^n       df (n f0^(n-1) + df (...))      f^a     f0^a expm1(a log1p(df/f0))
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce

import sympy
from sympy.codegen.cfunctions import expm1, log1p

from fem_snh.materials.functions import fractions, where

Pair = tuple[sympy.Expr, sympy.Expr]
_ZERO = sympy.Integer(0)


class AboutRest:
    """Pairs (f0, df) of expressions; ``moved`` has each measure's value at rest and its change."""

    def __init__(self, moved: Mapping[sympy.Symbol, Pair]) -> None:
        self._known: dict[sympy.Expr, Pair] = dict(moved)
        self._whole = {m: rest + change for m, (rest, change) in moved.items()}
        self._rest = {m: rest for m, (rest, _) in moved.items()}

    def __call__(self, expression: sympy.Expr) -> Pair:
        """(f0, df) of the expression; f0 is simplified, so that what vanishes is 0."""
        at_rest, change = self._pair(fractions(sympy.sympify(expression)))
        return sympy.simplify(at_rest), change

    def _pair(self, f: sympy.Expr) -> Pair:
        if f not in self._known:
            self._known[f] = self._of(f) if f.free_symbols & set(self._rest) else (f, _ZERO)
        return self._known[f]

    def _of(self, f: sympy.Expr) -> Pair:
        pairs = [self._pair(a) for a in f.args]
        if f.is_Add:
            return sympy.Add(*(a for a, _ in pairs)), sympy.Add(*(d for _, d in pairs))
        if f.is_Mul:
            return reduce(_product, pairs)
        (f0, df), *rest = pairs
        nonzero = not sympy.simplify(f0).is_zero
        if f.is_Pow and f.exp.is_Integer and (f.exp > 0 or nonzero):
            power = _power(f0, df, abs(int(f.exp)))
            return power if f.exp > 0 else _inverse(*power)
        if f.is_Pow and f.exp.is_number and nonzero:
            return f0**f.exp, f0**f.exp * expm1(f.exp * log1p(df / f0))
        if isinstance(f, sympy.log) and nonzero:
            return sympy.log(f0), log1p(df / f0)
        if isinstance(f, sympy.exp):
            return sympy.exp(f0), sympy.exp(f0) * expm1(df)
        if isinstance(f, where):
            (a0, da), (b0, db) = rest
            # A number: what separates the pieces is a matter of the measures.
            here = a0 if f0.is_positive else b0
            return here, where(f0 + df, da + (a0 - here), db + (b0 - here))
        at_rest = f.subs(self._rest)
        return at_rest, f.subs(self._whole) - at_rest


def _product(f: Pair, g: Pair) -> Pair:
    (f0, df), (g0, dg) = f, g
    return f0 * g0, f0 * dg + df * (g0 + dg)


def _power(f0: sympy.Expr, df: sympy.Expr, n: int) -> Pair:
    """(f0 + df)^n - f0^n by Horner's rule."""
    inner: sympy.Expr = _ZERO
    for k in range(n, 0, -1):
        inner = df * (sympy.binomial(n, k) * f0 ** (n - k) + inner)
    return f0**n, inner


def _inverse(f0: sympy.Expr, df: sympy.Expr) -> Pair:
    return 1 / f0, -df / (f0 * (f0 + df))
