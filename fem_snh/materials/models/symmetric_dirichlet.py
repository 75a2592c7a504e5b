"""The material ``symmetric_dirichlet``."""

from fem_snh.materials.invariants import positive
from fem_snh.materials.models._terms import volume_term


def symmetric_dirichlet(I_C, II_C, J, mu, lam, *, volume: str = "J"):
    """Symmetric Dirichlet energy (Chen & Barbic, Table 1), with a volume term.

    ::

        psi = mu/4 (||F||^2 + ||F^-1||^2 - 6) + volume = mu/4 (I_C + II_C/J^2 - 6) + volume

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame (with the factor 1/2 of the table, mu_lame would be 2).
    volume : str
        Volume term: "J" is lam/2 (J - 1)^2, "log" is lam/2 (log J)^2.

    Notes
    -----
    Infinite for J <= 0. Without the volume term nu = 0; the volume term vanishes at nu = 0.

    References
    ----------
    Smith & Schaefer 2015.
    """
    return mu / 4 * (I_C + II_C / positive(J) ** 2 - 6) + volume_term(J, lam, volume)
