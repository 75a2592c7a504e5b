"""The material ``stable_fung``."""

from sympy import exp

from fem_snh.materials.invariants import exact


def stable_fung(I_C, J, mu, lam, *, gamma: float = 0.1, mu_1: float = 1.0):
    """Stable Neo-Hookean energy with exponential hardening (Smith et al. 2018, eq. 53).

    ::

        psi = mu/2 (I_C - 3) + gamma mu/2 (exp(mu_1/2 (I_C - 3)) - 1) + lam/2 (J - alpha)^2
        alpha = 1 + (mu + gamma mu mu_1/2)/lam

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa].
    gamma : float
        Size of the hardening, in units of mu.
    mu_1 : float
        Rate of the hardening.

    Notes
    -----
    Finite for every F.

    Smith et al. print mu_0 + gamma mu_1 in alpha, with which the rest state is stressed. In eq. 52,
    gamma_I = mu + (gamma mu mu_1/2) e^(...) and gamma_F = (gamma mu mu_1^2/2) e^(...).
    """
    g, rate = exact(gamma), exact(mu_1)  # P(I) = 0 to the last digit
    hardening = g * mu / 2 * (exp(rate / 2 * (I_C - 3)) - 1)
    pressure = mu + g * mu * rate / 2
    return mu / 2 * (I_C - 3) + hardening - pressure * (J - 1) + lam / 2 * (J - 1) ** 2
