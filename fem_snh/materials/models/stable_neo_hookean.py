"""The material ``stable_neo_hookean``."""

from sympy import Rational, log


def stable_neo_hookean(I_C, J, mu, lam, *, nu: float, barrier: bool | None = None):
    """Stable Neo-Hookean energy (Smith et al. 2018, eq. 13 and 14); finite and smooth for every F.

    ::

        psi = mu/2 (I_C - 3) - mu (J - 1) + lam/2 (J - 1)^2                         (eq. 13)
        psi = mu/2 (I_C - 3) + lam/2 (J - alpha)^2 - mu/2 log(I_C + 1)              (eq. 14)
        alpha = 1 + mu/lam - mu/(4 lam)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa].
    barrier : bool, optional
        True for eq. 14, whose origin barrier makes F = 0 unstable; False for eq. 13. By default
        True for nu < 0.4 only (Appendix D).

    Notes
    -----
    The paper prints (mu/4) lam in alpha, with which the rest state is stressed.

    References
    ----------
    Smith, de Goes & Kim 2018.
    """
    if barrier is None:
        barrier = nu < 0.4
    if not barrier:
        return mu / 2 * (I_C - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** 2
    alpha = 1 + Rational(3, 4) * mu / lam
    return mu / 2 * (I_C - 3) + lam / 2 * (J - alpha) ** 2 - mu / 2 * log(I_C + 1)
