"""The material ``peng_landel``."""

from sympy import log

from fem_snh.materials.models._terms import volume_term


def peng_landel(s0, s1, s2, mu, lam, *, volume: str = "J"):
    """Peng-Landel energy (Chen & Barbic, Table 1), with a volume term.

    ::

        psi = 3 mu sum (s_i - 1 - log s_i - (log s_i)^2/6 + (log s_i)^3/18 - (log s_i)^4/216)
              + volume

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame; 3 mu is E in the table.
    volume : str
        Volume term: "J" is lam/2 (J - 1)^2, "log" is lam/2 (log J)^2.

    Notes
    -----
    Infinite for J <= 0. The term -log^4 decreases without bound as a stretch tends to 0. Without
    the volume term nu = 0; the volume term vanishes at nu = 0.

    References
    ----------
    Peng & Landel 1972.
    """
    length = sum(
        s - 1 - log(s) - log(s) ** 2 / 6 + log(s) ** 3 / 18 - log(s) ** 4 / 216
        for s in (s0, s1, s2)
    )
    return 3 * mu * length + volume_term(s0 * s1 * s2, lam, volume)
