"""The material ``fixed_corotational``."""


def fixed_corotational(I1, I_C, J, mu, lam):
    """ "Fixed" corotational energy (Smith et al. 2018, eq. 49).

    ::

        psi = mu ||F - R||^2 + lam/2 (J - 1)^2
        ||F - R||^2 = I_C - 2 I1 + 3,  I1 = tr S

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.

    Notes
    -----
    Finite for every F. It has no Hessian where two signed stretches sum to zero.

    References
    ----------
    Stomakhin et al. 2012.
    """
    return mu * (I_C - 2 * I1 + 3) + lam / 2 * (J - 1) ** 2
