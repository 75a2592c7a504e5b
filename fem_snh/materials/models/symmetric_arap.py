"""The material ``symmetric_arap``."""

from fem_snh.materials.invariants import positive
from fem_snh.materials.models._terms import volume_term


def symmetric_arap(s0, s1, s2, mu, lam, *, volume: str = "J"):
    """Symmetric as-rigid-as-possible energy (Chen & Barbic, Table 1), with a volume term.

    ::

        psi = mu/2 (||F - R||^2 + ||F^-1 - R^-1||^2) + volume
        ||F - R||^2 + ||F^-1 - R^-1||^2 = sum ((s_i - 1)^2 + (1/s_i - 1)^2)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame.
    volume : str
        Volume term: "J" is lam/2 (J - 1)^2, "log" is lam/2 (log J)^2.

    Notes
    -----
    Infinite for J <= 0. Without the volume term nu = 0; the volume term vanishes at nu = 0.

    References
    ----------
    Shtengel et al. 2017.
    """
    # The invariants' sum 1/s_i = (I1^2 - I_C)/(2 J) loses all digits where one stretch is large.
    length = sum((s - 1) ** 2 + (1 / positive(s) - 1) ** 2 for s in (s0, s1, s2))
    return mu / 2 * length + volume_term(s0 * s1 * s2, lam, volume)
