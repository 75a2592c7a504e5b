"""The material ``neo_hookean_wang``."""

from sympy import Rational


def neo_hookean_wang(I_C, J, mu, lam):
    """Neo-Hookean energy with a linear volume term (Psi_C of Smith et al. 2018), as printed.

    ::

        psi = mu/2 (J^(-2/3) I_C - 3) + lam/2 (J - 1)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu_lame = mu - lam/4, lambda_lame = lam/2 - 2/3 mu, by second derivatives.

    Notes
    -----
    Infinite for J <= 0. The volume term is linear in J: a constant pressure lam/2 that does not
    resist volume changes. The rest state is stressed (P = lam/2 I), the energy has no minimum, and
    the body shrinks for lam > 0. The energy is included for comparison; `neo_hookean_bower` has
    (J - 1)^2.

    References
    ----------
    Wang & Yang 2016.
    """
    return mu / 2 * (J ** Rational(-2, 3) * I_C - 3) + lam / 2 * (J - 1)
