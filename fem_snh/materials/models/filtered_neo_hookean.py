"""The material ``filtered_neo_hookean``."""

from collections.abc import Callable
from typing import Any

from sympy import Float, Rational, log, sqrt

from fem_snh.errors import bad_value, choose
from fem_snh.materials.invariants import PrincipalStress, where


def filtered_neo_hookean(s0, s1, s2, mu, lam, *, sigma_f: float = 0.25, bound: str = "stretch"):
    """Neo-Hookean stress, filtered below a stretch; it is not the gradient of an energy.

    ::

        psi = none
        P_i = mu s_i - p / s_i' [+ p e_i / s_i'^2 + lam / s_i' sum_j e_j / s_j']
        p = mu - lam log J',  J' = s0' s1' s2',  e_i = s_i - s_i',  s' = max(s, t)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    sigma_f : float
        Threshold of the filter, above 0 and at most 1.
    bound : str
        Quantity that the filter bounds. "stretch": every stretch, t = sigma_f, without the terms in
        brackets (the singular part is constant below). "J": the volume, t such that J' = max(J,
        sigma_f), with the terms in brackets (a linear continuation).

    Notes
    -----
    bound = "J" with 0.25 is the default of PhysBAM, the code of the comparison in Smith et al.
    2018.

    The stress is not the gradient of an energy where one stretch is filtered and another is not.
    The line search therefore uses the residual, and the tangent is the symmetric part of the exact
    derivative (PhysBAM takes the tangent of eq. 5 at s'). The Hessian filters of this program
    replace the papers' threshold for the eigenvalues of the Hessian (-1e-4).

    References
    ----------
    Irving et al. 2004.

    Teran et al. 2005.

    Smith et al. 2018, eq. 5.
    """
    if not 0 < sigma_f <= 1:  # the rest state is not filtered
        raise bad_value("sigma_f", sigma_f, "a number > 0 and <= 1")
    stress = _BOUNDS[choose("bound", bound, list(_BOUNDS))]
    return PrincipalStress(*stress((s0, s1, s2), mu, lam, Float(sigma_f)))


def _by_stretch(s, mu, lam, limit):
    kept = [where(x - limit, x, limit) for x in s]
    p = mu - lam * sum(log(k) for k in kept)
    return [mu * x - p / k for x, k in zip(s, kept, strict=True)]


def _by_volume(s, mu, lam, limit):
    J = s[0] * s[1] * s[2]
    # t raises the smallest stretch, then the two smallest, then all, until their product is limit.
    larger, smaller = where(s[0] - s[1], s[0], s[1]), where(s[0] - s[1], s[1], s[0])
    first = where(larger - s[2], larger, s[2])
    rest = where(larger - s[2], s[2], larger)
    second = where(rest - smaller, rest, smaller)
    all_three = limit ** Rational(1, 3)
    one_or_two = where(
        first * second**2 - limit, limit / (first * second), sqrt(limit) / sqrt(first)
    )
    t = where(first - all_three, one_or_two, all_three)
    kept = [where(x - t, x, t) for x in s]
    beyond = [x - k for x, k in zip(s, kept, strict=True)]
    log_J = log(where(J - limit, J, limit))
    sheared = sum(e / k for e, k in zip(beyond, kept, strict=True))
    parts = [
        (x - 1 / k + e / k**2, (log_J + sheared) / k - log_J * e / k**2)
        for x, k, e in zip(s, kept, beyond, strict=True)
    ]
    return [mu * own + lam * other for own, other in parts]


_BOUNDS: dict[str, Callable[..., list[Any]]] = {"stretch": _by_stretch, "J": _by_volume}
