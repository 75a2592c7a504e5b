"""A linearly elastic ball between two rigid planes, which Hertz takes for two half-spaces.

A ball's displacement under a load that is symmetric about an axis is a series of Legendre's
polynomials (Lur'e 1964, chapter 6). With Hertz's pressure on both poles it is the theory of Hertz
with the ball's own compliance: to first order in a/R, the contact radius over the ball's radius.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from scipy.optimize import brentq

#: Terms of the series, whose last wavelength is a tenth of a contact radius of R/30, and points of
#: the quadrature over the contact: twice as many change the force by less than 2e-4.
_TERMS, _POINTS = 2000, 400


def depth_ratio(a: float, nu: float) -> float:
    """Return the approach of pole and equator over a^2/R, that of Hertz, at contact radius a R."""
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
    angle, weights = 0.5 * np.arcsin(a) * (nodes + 1), 0.5 * np.arcsin(a) * weights
    x, s = np.cos(angle), np.sin(angle)
    # R = 1, G = 1/2: displacements u and radial stress over 2 G.
    load = -2 * a / (pi * (1 - nu)) * np.sqrt(np.maximum(0.0, 1 - (s / a) ** 2)) * s * weights
    u = load.sum() * (1 - 2 * nu) / (1 + nu)  # n = 0, uniform pressure: as of the bulk modulus
    before, P = np.ones_like(x), x.copy()
    for n in range(1, _TERMS):
        if n % 2 == 0:  # the others cancel, as both poles are loaded
            A = -0.5 * (2 * n + 1) * float(load @ P) / (n**2 + (1 + 2 * nu) * n + 1 + nu)
            B = -A * (n**2 + 2 * n - 1 + 2 * nu) / (n - 1)  # no shear stress
            u += A * (n + 1) * (n - 2 + 4 * nu) + B * n
        before, P = P, ((2 * n + 1) * x * P - n * before) / (n + 1)
    return float(-u / a**2)


def force_ratio(depth: float, nu: float) -> float:
    """Return the ball's force over that of Hertz at a depth, in the ball's radius."""

    def error(ratio: float) -> float:
        a = ratio * sqrt(depth)
        return ratio**2 * depth_ratio(a, nu) - 1

    return float(brentq(error, 1.0, 1.1, xtol=1e-6)) ** 3
