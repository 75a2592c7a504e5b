"""Neo-Hookean whose energy goes on beyond its singularity."""

from __future__ import annotations

from typing import Any

from sympy import log

from fem_snh.materials.functions import where


def c2_neo_hookean(I_C: Any, J: Any, mu: Any, lam: Any, *, threshold: float = 0.4) -> Any:
    """Neo-Hookean with an extrapolated energy, after Stomakhin et al. 2012: C2, finite for every F.

    psi = mu/2 (I_C - 3) + V(J),  V = -mu log J + lam/2 (log J)^2   (eq. 5) for J >= threshold,
    and its Taylor polynomial of second order at J = threshold below.

    After theirs: the convex threshold surface J = threshold, and that the energy is extrapolated,
    not the stress. Unlike theirs: they extrapolate all of psi along the ray from the identity
    (where it meets the surface is the root of a cubic), here it is V along J, which is all that is
    singular in psi: one closed expression, and no SVD. Both are eq. 5 to second order at the
    surface and differ by the third. threshold: the default of their code is 0.3.
    mu = mu_lame, lam = lambda_lame.
    """
    a, L = threshold, log(threshold)
    slope, curve = (lam * L - mu) / a, (mu + lam - lam * L) / a**2
    beyond = -mu * L + lam / 2 * L**2 + slope * (J - a) + curve / 2 * (J - a) ** 2
    return mu / 2 * (I_C - 3) + where(J - a, -mu * log(J) + lam / 2 * log(J) ** 2, beyond)
