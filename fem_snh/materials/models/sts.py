"""The material ``sts``."""

from fem_snh.materials.models.neo_hookean import neo_hookean


def sts(I_C, II_C, J, mu, lam, *, mu_4: float = 1.0):
    """STS energy for soft tissue (Chen & Barbic, Table 1).

    ::

        psi = mu/2 (I_C - 3) - mu log J + lam/2 (log J)^2 + mu_4 mu/8 sum (s_i^2 - 1)^4

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    mu_4 : float
        Size of the stiffening term, in units of mu.

    Notes
    -----
    Infinite for J <= 0. The sum is a polynomial in the invariants (Newton's identities), so the
    energy needs no stretches.

    References
    ----------
    Pai et al. 2018.
    """
    p1, III = I_C, J**2
    p2 = I_C * p1 - 2 * II_C
    p3 = I_C * p2 - II_C * p1 + 3 * III
    p4 = I_C * p3 - II_C * p2 + III * p1
    quartic = p4 - 4 * p3 + 6 * p2 - 4 * p1 + 3
    return neo_hookean(I_C, J, mu, lam) + mu_4 * mu / 8 * quartic
