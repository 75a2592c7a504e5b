"""Divided differences of the principal stresses, without dividing by a small difference.

Where s_j and s_k are nearly equal, (psi_j - psi_k)/(s_j - s_k) would lose as many digits as they
share. psi_k is psi_j with s_j and s_k exchanged; so with f' the exchanged f, the divided difference
[f] = (f - f')/(s_j - s_k) of every part of the expression follows from those of its parts::

    [s_j] = 1, [s_k] = -1, [f + g] = [f] + [g], [f g] = [f] g + f' [g]
    [f^n] = [f] sum_m f^m f'^(n-1-m)          [log f] = [f]/f' log_slope(d/f')
    [f^a] = [f] f'^(a-1) power_slope(d/f', a) [exp f] = [f] exp(f') exp_slope(d)

with d = f - f' = [f] (s_j - s_k), and log_slope(x) = log(1 + x)/x and so on (log_exp_series.h).

For (psi_j + psi_k)/(s_j + s_k), where an inverted s_k is nearly -s_j, f' has s_j and s_k exchanged
and their signs changed, which changes no energy that is smooth there.
"""

from __future__ import annotations

import sympy

from fem_snh.materials.functions import where

exp_slope, log_slope = sympy.Function("exp_slope"), sympy.Function("log_slope")


class power_slope(sympy.Function):
    """((1 + x)^a - 1)/x"""

    nargs = (2,)


class Divided:
    """[f] for the stretches x and y; ``sign`` -1 for the sums of inverted ones."""

    def __init__(self, x: sympy.Symbol, y: sympy.Symbol, sign: int = 1) -> None:
        self._exchange = {x: sign * y, y: sign * x}
        self._gap = x - sign * y
        self._known = {x: sympy.Integer(1), y: sympy.Integer(-sign)}

    def exchanged(self, f: sympy.Expr) -> sympy.Expr:
        """f', f with the stretches exchanged."""
        return f.xreplace(self._exchange)

    def __call__(self, f: sympy.Expr) -> sympy.Expr:
        """[f]"""
        if f not in self._known:
            alone = not f.free_symbols & set(self._exchange)
            self._known[f] = sympy.Integer(0) if alone else self._of(f)
        return self._known[f]

    def _of(self, f: sympy.Expr) -> sympy.Expr:
        if f.is_Add:
            return sympy.Add(*map(self, f.args))
        if f.is_Mul:
            head, tail = f.as_two_terms()
            return self(head) * tail + self.exchanged(head) * self(tail)
        if isinstance(f, where):
            condition, a, b = f.args
            apart = (f - self.exchanged(f)) / self._gap  # s_j and s_k in different pieces
            other = self.exchanged(condition)
            return where(condition, where(other, self(a), apart), where(other, apart, self(b)))
        inner = f.args[0]
        slope, old = self(inner), self.exchanged(inner)
        if slope == 0:
            return sympy.Integer(0)
        gap = slope * self._gap
        if f.is_Pow and f.exp.is_Integer:
            n = abs(int(f.exp))
            total = slope * sum(inner**m * old ** (n - 1 - m) for m in range(n))
            return total if f.exp > 0 else -total / (inner * old) ** n
        if f.is_Pow and f.exp.is_number:
            return slope * old ** (f.exp - 1) * power_slope(gap / old, f.exp)
        if isinstance(f, sympy.log):
            return slope / old * log_slope(gap / old)
        if isinstance(f, sympy.exp):
            return slope * sympy.exp(old) * exp_slope(gap)
        return (f - self.exchanged(f)) / self._gap
