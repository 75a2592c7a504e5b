"""The material ``neo_hookean_bower``."""

from sympy import Rational

from fem_snh.materials.registry import Published, bulk

PUBLISHED = (
    Published({"C10": "Coefficient of I1 - 3 [Pa]: mu = 2 C10."}, lambda C10: {"mu": 2 * C10}),
    bulk("lam"),
)


def neo_hookean_bower(I_C, J, mu, lam):
    """Neo-Hookean energy with an isochoric length term (Psi_B of Smith et al. 2018).

    ::

        psi = mu/2 (J^(-2/3) I_C - 3) + lam/2 (J - 1)^2

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame; lam = lambda_lame + 2/3 mu is the bulk modulus.

    Notes
    -----
    Infinite for J <= 0. The energy is infinite for a body that is crushed to a plane, but under
    uniform compression the length term is zero and the energy tends to lam/2 as J -> 0.

    References
    ----------
    Bower 2009.
    """
    return mu / 2 * (J ** Rational(-2, 3) * I_C - 3) + lam / 2 * (J - 1) ** 2
