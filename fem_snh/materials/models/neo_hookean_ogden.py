"""The material ``neo_hookean_ogden``."""

from sympy import log


def neo_hookean_ogden(I_C, J, mu, lam):
    """Neo-Hookean energy with a quadratic volume term (Psi_A of Smith et al. 2018).

    ::

        psi = mu/2 (I_C - 3) - mu log J + lam/2 (J - 1)^2

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.

    Notes
    -----
    Infinite for J <= 0.

    References
    ----------
    Ogden 1997.
    """
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * (J - 1) ** 2
