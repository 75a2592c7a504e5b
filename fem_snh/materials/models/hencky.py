"""The material ``hencky``."""

from sympy import log

from fem_snh.materials.models._terms import quadratic


def hencky(s0, s1, s2, mu, lam):
    """Hencky energy: quadratic in the logarithmic strain (Chen & Barbic, Table 1).

    ::

        psi = mu sum (log s_i)^2 + lam/2 (log J)^2

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.

    Notes
    -----
    Infinite for J <= 0. The stress decreases beyond a stretch of e. The energy is the limit of
    `seth_hill` for n -> 0. The nonlinearity alpha does not change it.
    """
    return quadratic([log(s) for s in (s0, s1, s2)], mu, lam)
