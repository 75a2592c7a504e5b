"""The Neo-Hookean energy with Ciarlet's volume term."""

from __future__ import annotations

from typing import Any

from sympy import log


def neo_hookean_ciarlet(I_C: Any, J: Any, mu: Any, lam: Any) -> Any:
    """Neo-Hookean with Ciarlet's volume term (psi_1 of Schröder et al. 2021): infinite for J <= 0.

    psi = mu/2 (I_C - 3) - mu log J + lam/4 (J^2 - 1 - 2 log J)

    mu = mu_lame, lam = lambda_lame.
    """
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 4 * (J**2 - 1 - 2 * log(J))
