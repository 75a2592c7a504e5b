"""Deformation gradients, and matrix formulas of Smith et al. 2018."""

from __future__ import annotations

import numpy as np
from points import STATES, deformations

NU = 0.3
UPRIGHT = deformations([STATES["random"], STATES["stretched"], (0.9, 0.7, 0.5), (1.2, 0.6, 0.1)])
ANY = np.concatenate(
    [UPRIGHT, deformations([STATES["inverted"], STATES["all negative"], (1, 0.3, -2)])]
)
LENGTH, VOLUME = "I_C/2 + sqrt(I_C + 1)/5", "exp(J - 1) - J"


def invariants(F):
    return (F**2).sum(), np.linalg.det(F)


def cofactor(F):
    """dJ/dF, by cross products of columns: right for singular F too."""
    a, b, c = F.T
    return np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)]).T


def rotation(F):
    """R of F = R S with det R = 1 (rotation-variant, eq. 2)."""
    U, _, Vt = np.linalg.svd(F)
    return U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
