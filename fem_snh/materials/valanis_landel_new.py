"""The newer Valanis-Landel form, with functions of one's own."""

from __future__ import annotations

from typing import Any

from sympy import Symbol, log

from fem_snh.materials._expressions import parse
from fem_snh.materials._functions import positive


def valanis_landel_new(
    s0: Any,
    s1: Any,
    s2: Any,
    mu: Any,
    lam: Any,
    *,
    length: str = "s * (log(s) - 1)",
    volume: str = "(J - 1)**2 / 2",
) -> Any:
    """Valanis-Landel in its newer form (Valanis 2022, Chen et al. 2023; Chen & Barbic, Table 1).

    Infinite for J <= 0.

    psi = mu (sum f(s_i) - f'(1) log J) + lam (h(J) - h'(1) log J)

    length: f as an expression in s; volume: h as one in J; of numbers, + - * / ** ( ), log, exp,
    sqrt. The logarithms complete functions whose slope at rest is not zero, so that the rest state
    is free of stress; the table has none. Then mu_lame = mu (f''(1) + f'(1))/2 and
    lambda_lame = lam (h''(1) + h'(1)).
    """
    s, J = Symbol("s", real=True), positive(s0 * s1 * s2)
    x = Symbol("J", real=True)
    f, h = parse(length, {"s": s}), parse(volume, {"J": x})
    one = sum(f.subs(s, positive(y)) for y in (s0, s1, s2)) - f.diff(s).subs(s, 1) * log(J)
    return mu * one + lam * (h.subs(x, J) - h.diff(x).subs(x, 1) * log(J))
