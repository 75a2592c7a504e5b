"""The material ``stable_neo_hookean``."""

from typing import Annotated

from sympy import Rational, log

from fem_snh.materials.parameters import Variant


def _has_barrier(nu: float) -> bool:
    """Return whether Smith et al. 2018 use eq. 14 at Poisson's ratio nu (Appendix D)."""
    return nu < 0.4


_BARRIER = Variant(
    _has_barrier, {True: "eq. 14 of Smith et al. 2018", False: "eq. 13 of Smith et al. 2018"}
)


def stable_neo_hookean(
    I_C, J, mu, lam, *, nu: float, barrier: Annotated[bool | None, _BARRIER] = None
):
    """Stable Neo-Hookean energy (Smith et al. 2018, eq. 13 and 14); finite and smooth for every F.

    ::

        psi = mu/2 (I_C - 3) - mu (J - 1) + lam/2 (J - 1)^2                         (eq. 13)
        psi = mu/2 (I_C - 3) + lam/2 (J - alpha)^2 - mu/2 log(I_C + 1)              (eq. 14)
        alpha = 1 + mu/lam - mu/(4 lam)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame + mu_lame in eq. 13; mu = 4/3 mu_lame, lam =
        lambda_lame + 5/6 mu_lame in eq. 14.
    barrier : bool, optional
        True for eq. 14, whose origin barrier makes F = 0 unstable; False for eq. 13. By default
        True for nu < 0.4 only (Appendix D): at nu = 0.4 the stress in uniaxial tension jumps by 10
        to 17 %. A run prints which equation it uses; a sweep or a fit of nu uses only one.

    Notes
    -----
    Smith et al. print (mu/4) lam in alpha, with which the rest state is stressed.

    References
    ----------
    Smith, de Goes & Kim 2018.
    """
    if not barrier:
        return mu / 2 * (I_C - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** 2
    alpha = 1 + Rational(3, 4) * mu / lam
    return mu / 2 * (I_C - 3) + lam / 2 * (J - alpha) ** 2 - mu / 2 * log(I_C + 1)
