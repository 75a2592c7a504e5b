"""The material ``stvk_kikuuwe``."""

from fem_snh.materials.invariants import where
from fem_snh.materials.models.stvk import stvk


def stvk_kikuuwe(I_C, II_C, J, mu, lam, *, kappa: float = 400.0):
    """St. Venant-Kirchhoff energy with a resistance to compression (Smith et al. 2018, eq. 51).

    ::

        psi = mu ||E||^2 + lam/2 tr(E)^2 + K/12 ((1 - J)/6)^3 where J < 1,  K = kappa mu

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    kappa : float
        The resistance, in units of mu.

    Notes
    -----
    Finite for every F. A body with a small kappa has a second rest state, turned inside out: the
    stretches (a, a, -a) are a minimum unless K > 864 (mu + 3/2 lam) (1 - a^2) / (a (1 + a^3)^2),
    where a^2 = (2 mu + 3 lam) / (4 mu + 3 lam). The bound is 333 mu at nu = 0, 216 mu at nu = 1/2
    and at most 351 mu (nu = -0.24).

    The factors 1/12 and 1/6^3 are as printed. The term vanishes for J >= 1.

    References
    ----------
    Kikuuwe et al. 2009.
    """
    resistance = kappa * mu / 12 * ((1 - J) / 6) ** 3
    return stvk(I_C, II_C, mu, lam) + where(1 - J, resistance, 0)
