"""The material ``neo_hookean``."""

from sympy import log


def neo_hookean(I_C, J, mu, lam):
    """Neo-Hookean energy of the textbooks (Smith et al. 2018, eq. 5).

    ::

        psi = mu/2 (I_C - 3) - mu log J + lam/2 (log J)^2

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.

    Notes
    -----
    Infinite for J <= 0.

    References
    ----------
    Bonet & Wood 2008.
    """
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2
