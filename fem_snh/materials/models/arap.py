"""The material ``arap``."""

from fem_snh.materials.models._terms import volume_term


def arap(I1, I_C, J, mu, lam, *, volume: str = "J"):
    """As rigid as possible (Chen & Barbic, Table 1), with a volume term.

    ::

        psi = mu ||F - R||^2 + volume,  ||F - R||^2 = I_C - 2 I1 + 3

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    volume : str
        Volume term: "J" is lam/2 (J - 1)^2, "log" is lam/2 (log J)^2.

    Notes
    -----
    Without the volume term nu = 0; the volume term vanishes at nu = 0. With "J" it is
    `fixed_corotational`. Finite for every F.

    It has no Hessian where two signed stretches sum to zero.

    References
    ----------
    Sorkine & Alexa 2007.
    """
    return mu * (I_C - 2 * I1 + 3) + volume_term(J, lam, volume)
