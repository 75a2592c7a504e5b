"""Neo-Hookean with a filtered stress: no energy."""

from __future__ import annotations

from typing import Any

from sympy import log

from fem_snh.materials._functions import PrincipalStress, where


def filtered_neo_hookean(
    s0: Any, s1: Any, s2: Any, mu: Any, lam: Any, *, sigma_f: float = 0.25
) -> Any:
    """Neo-Hookean, its stress filtered (Irving et al. 2004, Teran et al. 2005): no energy.

    psi = none;  P_i = mu s_i - (mu - lam log J') / s_i',  s' = max(s, sigma_f),  J' = s0' s1' s2'

    The stress of eq. 5 with what is singular in it held constant below the threshold sigma_f. It is
    no gradient where one stretch is filtered and another is not, so the line search is on the
    residual, and the tangent is the symmetric part of its derivative. The papers' threshold for
    the Hessian's eigenvalues (-1e-4) is not needed: the library's filters take its place.
    mu = mu_lame, lam = lambda_lame.
    """
    kept = [where(s - sigma_f, s, sigma_f) for s in (s0, s1, s2)]
    log_J = sum(log(k) for k in kept)
    stress = (mu * s - (mu - lam * log_J) / k for s, k in zip((s0, s1, s2), kept, strict=True))
    return PrincipalStress(*stress)
