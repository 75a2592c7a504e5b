"""The material ``corotational``."""


def corotational(I1, I_C, mu, lam):
    """Corotational linear elasticity (Smith et al. 2018, eq. 3).

    ::

        psi = mu ||F - R||^2 + lam/2 tr(S - I)^2
        ||F - R||^2 = I_C - 2 I1 + 3,  tr(S - I) = I1 - 3

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.

    Notes
    -----
    This is the PK1-linearisation of every material (Chen & Barbic, theorem 3.1). The sum of the
    stretches measures the volume, so a large stretch collapses the volume.

    Finite for every F. It has no Hessian where two signed stretches sum to zero.

    References
    ----------
    McAdams et al. 2011.
    """
    return mu * (I_C - 2 * I1 + 3) + lam / 2 * (I1 - 3) ** 2
