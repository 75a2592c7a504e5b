r"""Increments of expressions from the rest state, without cancellation.

An expression f of the measures is split as :math:`f = f_0 + df`. Here :math:`f_0` is its value at
rest, an expression of constants only, and df is its increment in terms of the measures' increments
(:math:`J - 1`, :math:`I_C - 3`, :math:`\sigma_i - 1`), which small_strain.h computes to full
relative accuracy. The values at rest cancel symbolically. The cancellation left in df is between
terms of the size of the strain:

.. math::

    d(f + g) &= df + dg & d\log f &= \mathrm{log1p}(df/f_0) \\
    d(f g) &= f_0\,dg + df\,(g_0 + dg) & d\exp f &= \exp(f_0)\,\mathrm{expm1}(df) \\
    d(f^n) &= df\,(n f_0^{n-1} + df(\dots)) \\
    d(f^a) &= f_0^a\,\mathrm{expm1}(a\,\mathrm{log1p}(df/f_0))
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import Any

import sympy
from sympy.codegen.cfunctions import expm1, log1p

from fem_snh.materials.functions import fractions, where

Pair = tuple[sympy.Expr, sympy.Expr]
_ZERO = sympy.Integer(0)


class Increments:
    """The map f -> (f0, df).

    Parameters
    ----------
    measures : mapping
        The value at rest and the symbol of the increment of each measure.
    """

    def __init__(self, measures: Mapping[sympy.Symbol, Pair]) -> None:
        self._known: dict[sympy.Expr, Pair] = dict(measures)
        self._whole = {m: rest + change for m, (rest, change) in measures.items()}
        self._rest = {m: rest for m, (rest, _) in measures.items()}

    def __call__(self, expression: sympy.Expr) -> Pair:
        """Return (f0, df); f0 is simplified, so that a value that vanishes is 0."""
        at_rest, change = self._pair(fractions(sympy.sympify(expression)))
        return sympy.simplify(at_rest), change

    def _pair(self, f: sympy.Expr) -> Pair:
        if f not in self._known:
            self._known[f] = self._apply(f) if f.free_symbols & set(self._rest) else (f, _ZERO)
        return self._known[f]

    def _apply(self, f: sympy.Expr) -> Pair:
        """Return (f0, df) by the rules above; df = f(x) - f(x at rest) for any other function."""
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
        if f.is_Pow and nonzero and not f.exp.free_symbols & set(self._rest):
            return f0**f.exp, f0**f.exp * expm1(f.exp * log1p(df / f0))
        if isinstance(f, sympy.log) and nonzero:
            return sympy.log(f0), log1p(df / f0)
        if isinstance(f, log1p) and not sympy.simplify(1 + f0).is_zero:
            return sympy.log(1 + f0), log1p(df / (1 + f0))
        if isinstance(f, sympy.exp):
            return sympy.exp(f0), sympy.exp(f0) * expm1(df)
        if isinstance(f, where):
            # The condition depends on the measures alone, so its value at rest is a number.
            at_rest = rest[0 if f0.is_positive else 1][0]
            changes = [self._change(f, *p, at_rest) for f, p in zip(f.args[1:], rest, strict=True)]
            return at_rest, where(f0 + df, *changes)
        at_rest = f.subs(self._rest)
        return at_rest, f.subs(self._whole) - at_rest

    def _change(self, piece: sympy.Expr, f0: sympy.Expr, df: sympy.Expr, rest: Any) -> Any:
        """Return ``piece - rest``; the piece that excludes the rest state may be singular there."""
        singular = (f0 + df).has(sympy.zoo, sympy.nan, sympy.oo)
        return piece.subs(self._whole) - rest if singular else df + (f0 - rest)


def _product(f: Pair, g: Pair) -> Pair:
    """Return (f0 g0, d(f g))."""
    (f0, df), (g0, dg) = f, g
    return f0 * g0, f0 * dg + df * (g0 + dg)


def _power(f0: sympy.Expr, df: sympy.Expr, n: int) -> Pair:
    """Return (f0^n, d(f^n)) by Horner's rule."""
    inner: sympy.Expr = _ZERO
    for k in range(n, 0, -1):
        inner = df * (sympy.binomial(n, k) * f0 ** (n - k) + inner)
    return f0**n, inner


def _inverse(f0: sympy.Expr, df: sympy.Expr) -> Pair:
    """Return (1/f0, d(1/f))."""
    return 1 / f0, -df / (f0 * (f0 + df))
