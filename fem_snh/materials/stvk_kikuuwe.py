"""St. Venant-Kirchhoff with a resistance to compression."""

from __future__ import annotations

from typing import Any

from fem_snh.materials._functions import where
from fem_snh.materials.stvk import stvk


def stvk_kikuuwe(I_C: Any, II_C: Any, J: Any, mu: Any, lam: Any, *, kappa: float = 100.0) -> Any:
    """St. Venant-Kirchhoff with the term of Kikuuwe et al. 2009 (Smith et al. 2018, eq. 51).

    psi = mu ||E||^2 + lam/2 tr(E)^2 + K/12 ((1 - J)/6)^3 where J < 1,  K = kappa (lam + 2 mu)

    kappa: the resistance in units of the P-wave modulus. With less than about 67 the state turned
    inside out is still a minimum. It does nothing in extension; mu = mu_lame, lam = lambda_lame.
    """
    resistance = kappa * (lam + 2 * mu) / 12 * ((1 - J) / 6) ** 3
    return stvk(I_C, II_C, mu, lam) + where(1 - J, resistance, 0)
