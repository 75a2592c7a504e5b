"""The material ``mooney_length``."""


def mooney_length(I_C, J, mu, lam):
    """Mooney's length term and a volume term, stressed at rest (Smith et al. 2018, eq. 8).

    ::

        psi = mu/2 (I_C - 3) + lam/2 (J - 1)^2

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu_lame = mu/2, lambda_lame = lam, by second derivatives.

    Notes
    -----
    Finite for every F. P(I) = mu I, so a free body shrinks (eq. 10). Smith et al. motivate their
    rest stabilisation with this energy; it is included for comparison.
    """
    return mu / 2 * (I_C - 3) + lam / 2 * (J - 1) ** 2
