"""Mooney's length term with a volume term, and no rest stability."""

from __future__ import annotations

from typing import Any


def mooney_length(I_C: Any, J: Any, mu: Any, lam: Any) -> Any:
    """Mooney's length term Psi_M with a volume term (Psi_D of Smith et al. 2018, eq. 8).

    Stressed at rest.

    psi = mu/2 (I_C - 3) + lam/2 (J - 1)^2

    Finite for every F, but P(I) = mu I: a free body deflates (eq. 10). That is the paper's argument
    for its rest stabilisation, and why this energy is here. By second derivatives mu_lame = mu/2,
    lambda_lame = lam.
    """
    return mu / 2 * (I_C - 3) + lam / 2 * (J - 1) ** 2
