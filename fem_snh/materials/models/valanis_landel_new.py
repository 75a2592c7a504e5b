"""The newer Valanis-Landel form, with functions of one's own."""

from __future__ import annotations

from typing import Any

from fem_snh.materials.models.valanis_landel_xu import valanis_landel_xu


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
    shapes = {"length": length, "area": "0", "volume": volume}
    return valanis_landel_xu(s0, s1, s2, mu, lam, **shapes)
