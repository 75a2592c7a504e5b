"""The Neo-Hookean energy with an isochoric length term."""

from __future__ import annotations

from typing import Any

from sympy import Rational


def neo_hookean_bower(I_C: Any, J: Any, mu: Any, lam: Any) -> Any:
    """Neo-Hookean of Bower 2009 (Psi_B of Smith et al. 2018): infinite for J <= 0.

    psi = mu/2 (J^(-2/3) I_C - 3) + lam/2 (J - 1)^2

    mu = mu_lame; lam = lambda_lame + 2/3 mu is the bulk modulus. Crushed to a plane it is infinite,
    but under uniform compression the length term stays zero, and J -> 0 costs lam/2 only.
    """
    return mu / 2 * (J ** Rational(-2, 3) * I_C - 3) + lam / 2 * (J - 1) ** 2
