"""Triangles and tetrahedra by their corners."""

from __future__ import annotations

from itertools import combinations
from math import factorial

import numpy as np
import numpy.typing as npt


def edges(corners: int) -> npt.NDArray[np.int64]:
    """Return the edges of a simplex with so many corners, (edges, 2)."""
    return np.array(list(combinations(range(corners), 2)))


def volumes(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the volumes of simplices from their corners, (cells, dim + 1, dim) [m^dim]."""
    dim = x.shape[2]
    found: npt.NDArray[np.float64] = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / factorial(dim)
    return found
