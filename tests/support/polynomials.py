"""Elements, and the vector fields that they hold exactly."""

from __future__ import annotations

import numpy as np

ELEMENTS = [("hexahedron", 1), ("tetrahedron", 1), ("hexahedron", 2), ("tetrahedron", 2)]


def quadratic(x):
    """A vector field within degree 2 that no two nodes of a cell can swap unnoticed."""
    return np.stack([x[0] * x[1] + x[2], x[1] * x[2] - x[0], x[2] * x[2] + 2 * x[1]])


def linear(x):
    return np.stack([x[0] - 2 * x[1], 3 * x[2] + x[1], x[0] + x[2]])
