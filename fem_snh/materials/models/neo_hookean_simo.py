"""The material ``neo_hookean_simo``."""

from sympy import Rational, log


def neo_hookean_simo(I_C, J, mu, lam):
    """Isochoric Neo-Hookean energy with the volume term of Simo, Taylor & Pister 1985.

    ::

        psi = mu/2 (J^(-2/3) I_C - 3) + lam/4 (J^2 - 1 - 2 log J)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame; lam = lambda_lame + 2/3 mu is the bulk modulus.

    Notes
    -----
    Infinite for J <= 0. Most published benchmarks use this energy, Cook's membrane among them
    (``python -m benchmarks references``).

    References
    ----------
    Simo, Taylor & Pister 1985.

    Simo & Armero 1992.
    """
    isochoric = mu / 2 * (J ** Rational(-2, 3) * I_C - 3)
    return isochoric + lam / 4 * (J**2 - 1 - 2 * log(J))
