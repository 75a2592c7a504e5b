"""Straighten the edges of curved tetrahedra that would be inverted inside.

A mesher curves the edges on a surface of a straight mesh, which must be finer than the surface's
radius for cells to stay valid. Where it is not, the edges are moved back towards straight ones:
neighbours keep their common nodes, and all other edges stay on the surface.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import factorial

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: The ends of the edges on which nodes 4 to 9 are (gmsh reference manual, node ordering).
_EDGES = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)])
#: The least Jacobian determinant of a cell over that with straight edges.
_LEAST = 0.1
#: Edges are straightened by halves, this often, and then wholly.
_HALVES = 4


def straightened(cells: npt.NDArray[np.int64], x: Array) -> Array:
    """Return coordinates with which no tetrahedron of degree 2 is inverted.

    Parameters
    ----------
    cells : (n, 10) int
        The nodes of cells, in gmsh's order, whose corners are those of valid straight cells.
    x : (nodes, 3)
        Coordinates.
    """
    x, ends = x.copy(), cells[:, _EDGES]
    middle = x.copy()
    middle[cells[:, 4:]] = (x[ends[..., 0]] + x[ends[..., 1]]) / 2
    times = np.zeros(len(x), dtype=int)
    while True:
        bad = least_determinants(x[cells]) < _LEAST
        nodes = np.unique(cells[bad, 4:])
        nodes = nodes[times[nodes] <= _HALVES]
        if not len(nodes):
            return x
        part = np.where(times[nodes] < _HALVES, 0.5, 0.0)[:, None]
        x[nodes] = middle[nodes] + part * (x[nodes] - middle[nodes])
        times[nodes] += 1


def least_determinants(x: Array) -> Array:
    """Return a lower bound of the determinant of each cell's Jacobian, relative to straight edges.

    The determinant is a polynomial of degree 3: it is nowhere below its least Bernstein coefficient
    (Johnen, Remacle & Geuzaine 2013).

    Parameters
    ----------
    x : (n, 10, 3)
        The nodes of tetrahedra of degree 2, in gmsh's order.
    """
    gradients, coefficients = _tables()
    jacobian = np.einsum("cni,pnj->cpij", x, gradients, optimize=True)
    straight = np.linalg.det(x[:, 1:4] - x[:, :1])
    return (np.linalg.det(jacobian) @ coefficients.T).min(axis=1) / straight


@cache
def _tables() -> tuple[Array, Array]:
    """Return gradients at the points of a lattice, and Bernstein coefficients from values there."""
    powers = np.array([p for p in product(range(4), repeat=4) if sum(p) == 3])
    points = powers / 3  # barycentric
    slopes = np.vstack([-np.ones(3), np.eye(3)])  # of the barycentric coordinates
    at_corners = np.einsum("pn,nj->pnj", 4 * points - 1, slopes)
    i, j = _EDGES.T
    at_edges = 4 * (points[:, i, None] * slopes[j] + points[:, j, None] * slopes[i])
    multinomial = [6 / np.prod([factorial(k) for k in power]) for power in powers]
    bernstein = np.prod(points[:, None] ** powers, axis=2) * multinomial
    return np.concatenate([at_corners, at_edges], axis=1), np.linalg.inv(bernstein)
