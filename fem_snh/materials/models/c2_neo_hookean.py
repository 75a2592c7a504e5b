"""The material ``c2_neo_hookean``."""

from sympy import log

from fem_snh.errors import bad_value
from fem_snh.materials.invariants import where


def c2_neo_hookean(I_C, J, mu, lam, *, threshold: float = 0.4):
    """Neo-Hookean energy, extrapolated below a threshold of J; finite for every F.

    ::

        psi = mu/2 (I_C - 3) + V(J)
        V = -mu log J + lam/2 (log J)^2 for J >= threshold

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    threshold : float
        Value of J below which V is its Taylor polynomial of second order at J = threshold.

    Notes
    -----
    Twice continuously differentiable. As in Stomakhin et al., the threshold surface J = threshold
    is convex, and the energy is extrapolated instead of the stress.

    Differences from Stomakhin et al.: they extrapolate all of psi along the ray from the identity,
    which meets the surface at the root of a cubic. Here only V, the singular term, is extrapolated
    along J: one closed expression without an SVD. Both extrapolations agree with eq. 5 to second
    order at the surface and differ in the third. The default threshold of their code is 0.3.

    References
    ----------
    Stomakhin et al. 2012.

    Smith et al. 2018, eq. 5.
    """
    if not 0 < threshold <= 1:  # the rest state, J = 1, is not extrapolated
        raise bad_value("threshold", threshold, "a number > 0 and <= 1")
    a, L = threshold, log(threshold)
    slope, curve = (lam * L - mu) / a, (mu + lam - lam * L) / a**2
    beyond = -mu * L + lam / 2 * L**2 + slope * (J - a) + curve / 2 * (J - a) ** 2
    return mu / 2 * (I_C - 3) + where(J - a, -mu * log(J) + lam / 2 * log(J) ** 2, beyond)
