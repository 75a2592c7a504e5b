"""Stable Neo-Hookean, the energy this library is named after."""

from __future__ import annotations

from typing import Any

from sympy import Rational, log


def stable_neo_hookean(
    I_C: Any, J: Any, mu: Any, lam: Any, *, nu: float, barrier: bool | None = None
) -> Any:
    """Stable Neo-Hookean of Smith, de Goes & Kim 2018: finite and smooth for every F.

    eq. 13: psi = mu/2 (I_C - 3) - mu (J - 1) + lam/2 (J - 1)^2

    eq. 14: psi = mu/2 (I_C - 3) + lam/2 (J - alpha)^2 - mu/2 log(I_C + 1),
            alpha = 1 + mu/lam - mu/(4 lam)  (the paper prints (mu/4) lam)

    barrier: with (True, eq. 14) or without (False, eq. 13) the origin barrier that keeps F = 0 from
    being stable. By default it is there for nu < 0.4 only, as Appendix D says.
    """
    if barrier is None:
        barrier = nu < 0.4
    if not barrier:
        return mu / 2 * (I_C - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** 2
    alpha = 1 + Rational(3, 4) * mu / lam
    return mu / 2 * (I_C - 3) + lam / 2 * (J - alpha) ** 2 - mu / 2 * log(I_C + 1)
