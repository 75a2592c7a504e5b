"""The material ``valanis_landel``."""

from sympy import log


def valanis_landel(s0, s1, s2, mu, lam):
    """Valanis-Landel energy (Chen & Barbic, Table 1).

    ::

        psi = 2 mu sum s_i (log s_i - 1) + lam/2 (log J)^2

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.

    Notes
    -----
    Infinite for J <= 0. In extension the stress grows slowly, as log s.

    References
    ----------
    Valanis & Landel 1967.
    """
    logs = [log(s) for s in (s0, s1, s2)]
    length = sum(s * (x - 1) for s, x in zip((s0, s1, s2), logs, strict=True))
    return 2 * mu * length + lam / 2 * sum(logs) ** 2
