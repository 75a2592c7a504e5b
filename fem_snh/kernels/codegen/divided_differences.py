r"""Divided differences of the principal stresses without cancellation.

Where :math:`\sigma_j` and :math:`\sigma_k` are nearly equal,
:math:`(\psi_j - \psi_k)/(\sigma_j - \sigma_k)` loses as many digits as they share.
:math:`\psi_k` is :math:`\psi_j` with the two stretches exchanged. Let f' be an expression f with
the stretches exchanged. Its divided difference :math:`[f] = (f - f')/(\sigma_j - \sigma_k)` follows
from those of its operands:

.. math::

    [\sigma_j] &= 1, \quad [\sigma_k] = -1 \\
    [f + g] &= [f] + [g], \quad [f g] = [f]\, g + f'\,[g] \\
    [f^n] &= [f] \sum_{m<n} f^m f'^{\,n-1-m} \\
    [\log f] &= [f]/f' \; \mathrm{log1p\_over\_x}(d/f') \\
    [f^a] &= [f]\, f'^{\,a-1}\, \mathrm{powm1\_over\_x}(d/f', a) \\
    [\exp f] &= [f] \exp(f')\, \mathrm{expm1\_over\_x}(d)

with :math:`d = f - f' = [f](\sigma_j - \sigma_k)`; log_exp_series.h has the three functions,
:math:`\mathrm{log1p\_over\_x}(x) = \log(1 + x)/x` and so on.

For :math:`(\psi_j + \psi_k)/(\sigma_j + \sigma_k)`, where an inverted :math:`\sigma_k` is close
to :math:`-\sigma_j`, f' has the stretches exchanged and their signs changed. An energy that is
smooth there keeps its value.
"""

from __future__ import annotations

import sympy
from sympy.codegen.cfunctions import log1p

from fem_snh.materials.functions import where

expm1_over_x, log1p_over_x = sympy.Function("expm1_over_x"), sympy.Function("log1p_over_x")


class powm1_over_x(sympy.Function):
    """The function ((1 + x)^a - 1)/x."""

    nargs = (2,)


class DividedDifference:
    """The map f -> [f] for the stretches x and y.

    Parameters
    ----------
    x, y : sympy.Symbol
        The stretches.
    sign : int
        1 for (f - f')/(x - y); -1 for (f - f')/(x + y), where f' has x and y exchanged and their
        signs changed.
    """

    def __init__(self, x: sympy.Symbol, y: sympy.Symbol, sign: int = 1) -> None:
        self._exchange = {x: sign * y, y: sign * x}
        self._difference = x - sign * y
        self._known = {x: sympy.Integer(1), y: sympy.Integer(-sign)}

    def exchange(self, f: sympy.Expr) -> sympy.Expr:
        """Return f': f with the stretches exchanged (and their signs changed if ``sign`` is -1)."""
        return f.xreplace(self._exchange)

    def __call__(self, f: sympy.Expr) -> sympy.Expr:
        """Return the divided difference [f]."""
        if f not in self._known:
            constant = not f.free_symbols & set(self._exchange)
            self._known[f] = sympy.Integer(0) if constant else self._apply(f)
        return self._known[f]

    def _apply(self, f: sympy.Expr) -> sympy.Expr:
        """Return [f] by the rules above, or (f - f')/(x - y) itself for any other function."""
        if f.is_Add:
            return sympy.Add(*map(self, f.args))
        if f.is_Mul:
            head, tail = f.as_two_terms()
            return self(head) * tail + self.exchange(head) * self(tail)
        if isinstance(f, where):
            condition, a, b = f.args
            apart = (f - self.exchange(f)) / self._difference  # the stretches in different pieces
            other = self.exchange(condition)
            return where(condition, where(other, self(a), apart), where(other, apart, self(b)))
        inner = f.args[0]
        divided, exchanged = self(inner), self.exchange(inner)
        if divided == 0:
            return sympy.Integer(0)
        d = divided * self._difference
        if f.is_Pow and f.exp.is_Integer:
            n = abs(int(f.exp))
            total = divided * sum(inner**m * exchanged ** (n - 1 - m) for m in range(n))
            return total if f.exp > 0 else -total / (inner * exchanged) ** n
        if f.is_Pow and not f.exp.free_symbols & set(self._exchange):
            return divided * exchanged ** (f.exp - 1) * powm1_over_x(d / exchanged, f.exp)
        if isinstance(f, sympy.log):
            return divided / exchanged * log1p_over_x(d / exchanged)
        if isinstance(f, log1p):
            return divided / (1 + exchanged) * log1p_over_x(d / (1 + exchanged))
        if isinstance(f, sympy.exp):
            return divided * sympy.exp(exchanged) * expm1_over_x(d)
        return (f - self.exchange(f)) / self._difference
