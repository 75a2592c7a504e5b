"""A Neo-Hookean energy as it was printed, with a volume term that is none."""

from __future__ import annotations

from typing import Any

from sympy import Rational


def neo_hookean_wang(I_C: Any, J: Any, mu: Any, lam: Any) -> Any:
    """Neo-Hookean of Wang & Yang 2016 (Psi_C of Smith et al. 2018), as printed: +inf for J <= 0.

    psi = mu/2 (J^(-2/3) I_C - 3) + lam/2 (J - 1)

    What its volume term does: it is linear in J, so it is a constant pressure lam/2, no resistance
    to volume changes. It has no minimum: the rest state is stressed (P = lam/2 I), and the body
    shrinks for lam > 0. Kept as printed, for comparison; `neo_hookean_bower` has the square. By
    second derivatives (eq. 3, 4): mu_lame = mu - lam/4, lambda_lame = lam/2 - 2/3 mu.
    """
    return mu / 2 * (J ** Rational(-2, 3) * I_C - 3) + lam / 2 * (J - 1)
