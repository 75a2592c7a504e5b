"""The Neo-Hookean energy with a quadratic volume term."""

from __future__ import annotations

from typing import Any

from sympy import log


def neo_hookean_ogden(I_C: Any, J: Any, mu: Any, lam: Any) -> Any:
    """Neo-Hookean of Ogden 1997 (Psi_A of Smith et al. 2018): infinite for J <= 0.

    psi = mu/2 (I_C - 3) - mu log J + lam/2 (J - 1)^2

    mu = mu_lame, lam = lambda_lame.
    """
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * (J - 1) ** 2
