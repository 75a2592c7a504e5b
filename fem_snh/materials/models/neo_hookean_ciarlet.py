"""The material ``neo_hookean_ciarlet``."""

from sympy import log


def neo_hookean_ciarlet(I_C, J, mu, lam):
    """Neo-Hookean energy with Ciarlet's volume term (psi_1 of Schröder et al. 2021).

    ::

        psi = mu/2 (I_C - 3) - mu log J + lam/4 (J^2 - 1 - 2 log J)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.

    Notes
    -----
    Infinite for J <= 0.
    """
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 4 * (J**2 - 1 - 2 * log(J))
