"""The sizes of cells of a new mesh, given on the cells of an old one: triangles and tetrahedra."""

from __future__ import annotations

from itertools import combinations
from math import factorial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Volume of a regular simplex with edges of length 1, by its dimension.
_REGULAR = {2: 3**0.5 / 4, 3: 2**0.5 / 12}
#: The largest change of the size over the distance: neighbours differ by about a third.
_GRADIENT = 0.35
#: Edges of gmsh's cells over the size that was asked for, by the dimension.
_LONGER = {2: 1.0, 3: 1.2}


class SizeField(NamedTuple):
    """A field of sizes, linear in each cell of a mesh.

    Attributes
    ----------
    x : (cells, corners, 3) array
        The corners of triangles or tetrahedra [m].
    sizes : (cells, corners) array
        Lengths of edges at the corners [m].
    """

    x: Array
    sizes: Array


def size_field(cells: npt.NDArray[np.int64], x: Array, volumes: Array) -> SizeField:
    """Return the sizes at the corners of cells in whose place are cells of other volumes.

    The sizes are graded. As grading makes cells smaller, all are then larger by a factor with which
    as many cells are expected as the volumes ask for.

    Parameters
    ----------
    cells : (cells, corners) array
        The corners of triangles or tetrahedra.
    x : (nodes, 2 or 3) array
        Coordinates [m].
    volumes : (cells,) array
        The volumes of cells that are wanted in the place of each [m^dim].
    """
    dim = x.shape[1]
    used, corners = np.unique(cells, return_inverse=True)
    corners, x = corners.reshape(cells.shape), x[used]
    own = simplex_volumes(x[corners])
    wanted = np.log(volumes / _REGULAR[dim]) / dim
    ends = corners.ravel()
    means = np.bincount(ends, np.repeat(wanted, dim + 1)) / np.bincount(ends)
    sizes = _graded(np.exp(means), corners, x)
    expected = (own / (_REGULAR[dim] * sizes[corners].mean(axis=1) ** dim)).sum()
    sizes *= (expected / (own / volumes).sum()) ** (1 / dim) / _LONGER[dim]
    points = np.zeros((len(x), 3))
    points[:, :dim] = x
    return SizeField(points[corners], sizes[corners])


def _graded(sizes: Array, cells: npt.NDArray[np.int64], x: Array) -> Array:
    """Return the largest sizes, none above those given, whose change along edges is limited."""
    pairs = simplex_edges(cells.shape[1])
    edges = np.unique(np.sort(cells[:, pairs].reshape(-1, 2), axis=1), axis=0)
    rise = _GRADIENT * np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
    sizes = sizes.copy()
    while True:
        before = sizes.copy()
        for here, there in (edges.T, edges.T[::-1]):
            np.minimum.at(sizes, here, sizes[there] + rise)
        if np.array_equal(sizes, before):
            return sizes


def simplex_edges(corners: int) -> npt.NDArray[np.int64]:
    """Return the edges of a simplex with so many corners, (edges, 2)."""
    return np.array(list(combinations(range(corners), 2)))


def simplex_volumes(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the volumes of simplices from their corners, (cells, dim + 1, dim) [m^dim]."""
    dim = x.shape[2]
    return np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / factorial(dim)
