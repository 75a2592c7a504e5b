"""The isochoric Neo-Hookean energy with Simo's volume term: the one of most benchmarks."""

from __future__ import annotations

from typing import Any

from sympy import Rational, log


def neo_hookean_simo(I_C: Any, J: Any, mu: Any, lam: Any) -> Any:
    """Neo-Hookean of Simo, Taylor & Pister 1985 and Simo & Armero 1992: infinite for J <= 0.

    psi = mu/2 (J^(-2/3) I_C - 3) + lam/4 (J^2 - 1 - 2 log J)

    mu = mu_lame; lam = lambda_lame + 2/3 mu is the bulk modulus. The energy of most published
    numbers (`python -m benchmarks references`), Cook's membrane among them.
    """
    isochoric = mu / 2 * (J ** Rational(-2, 3) * I_C - 3)
    return isochoric + lam / 4 * (J**2 - 1 - 2 * log(J))
