"""How much of each cell of a grid a solid fills, by samples of the signed distance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.arrays import Array
from fem_snh.geometry.shapes import Shape
from fem_snh.geometry.surface_nets import Grid, Integers, Triangles, cells_of_box
from fem_snh.mesh.bisection import MarkedEdges, edge_keys, simplex_edges, split

Coverage = npt.NDArray[np.float32]

#: Edge, in cells, of the blocks of cells that are discarded together if they are outside.
_BLOCK = 4
#: Cells whose samples are evaluated together, which bounds the memory.
_CELLS = 20_000


class Samples(NamedTuple):
    """The cells that a solid fills, whole or in part.

    Attributes
    ----------
    cells : (n, 3) int array
        The (i, j, k) of the cells in the grid, sorted.
    coverage : (n, s, s, s) float32 array
        The filled part of each of the s x s x s cubes of a cell, from 0 to 1.
    """

    cells: Integers
    coverage: Coverage

    @property
    def fractions(self) -> Array:
        """The filled part of each cell, (n,)."""
        return np.asarray(self.coverage.mean(axis=(1, 2, 3), dtype=float))


def sample_shape(shape: Shape, grid: Grid, samples: int) -> tuple[Samples, Integers]:
    """Return how much of each cell a shape fills, and the cells (m, 3) its surface may cut.

    A cube of edge a, whose centre has the signed distance d, counts as filled by the part
    min(max(1/2 - d/a, 0), 1), which is exact for planes parallel to its faces and in the mean over
    the positions of any plane. The volume of a solid with a smooth surface has an error of a^2.

    Parameters
    ----------
    shape : Shape
        The solid; where its distance is not exact, it is smaller in magnitude than the true one.
    grid : Grid
        The cells.
    samples : int
        Cubes along an edge of a cell.
    """
    # A distance has the Lipschitz constant 1: a cube does not meet the surface if its centre is
    # further away from the surface than from its corners.
    blocks = cells_of_box(np.zeros(3, np.int64), -(-grid.shape // _BLOCK))
    centres = grid.origin + grid.size * _BLOCK * (blocks + 0.5)
    blocks = blocks[shape.distance(centres) < grid.size * _BLOCK * np.sqrt(0.75)]
    within = cells_of_box(np.zeros(3, np.int64), np.full(3, _BLOCK))
    cells = (_BLOCK * blocks[:, None] + within).reshape(-1, 3)
    cells = cells[np.all(cells < grid.shape, axis=1)]
    distance, reach = shape.distance(grid.centres(cells)), grid.size * np.sqrt(0.75)
    cells, distance = cells[distance < reach], distance[distance < reach]
    coverage = np.ones((len(cells), *[samples] * 3), dtype=np.float32)
    cut = np.flatnonzero(distance > -reach)
    edge = grid.size / samples
    offsets = edge * (cells_of_box(np.zeros(3, np.int64), np.full(3, samples)) + 0.5)
    for start in range(0, len(cut), _CELLS):
        some = cut[start : start + _CELLS]
        corners = grid.origin + grid.size * cells[some]
        d = shape.distance((corners[:, None] + offsets).reshape(-1, 3))
        coverage[some] = np.clip(0.5 - d / edge, 0, 1).reshape(-1, *[samples] * 3)
    return sorted_samples(grid, cells, coverage), cells[cut]


def sorted_samples(grid: Grid, cells: Integers, coverage: Coverage) -> Samples:
    """Return the cells that are not empty, in the order of their keys."""
    filled = np.flatnonzero(coverage.any(axis=(1, 2, 3)))
    order = filled[np.argsort(grid.key(cells[filled]))]
    return Samples(cells[order], coverage[order])


def refine(points: Array, triangles: Integers, longest: float) -> tuple[Array, Triangles]:
    """Return the same surface with edges no longer than ``longest``.

    A triangle follows the deformation of a lattice only at its corners. Long edges are halved in
    both triangles, so that a closed surface remains closed.

    Parameters
    ----------
    points, triangles : (n, 3) array, (m, 3) int array
        The surface.
    longest : float
        The longest edge.
    """
    triangles = np.asarray(triangles, dtype=np.int64)
    while True:
        edges = triangles[:, simplex_edges(3)].reshape(-1, 2)
        edges = np.unique(np.sort(edges, axis=1), axis=0)
        length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
        edges, length = edges[length > longest], length[length > longest]
        if not len(edges):
            return points, triangles.astype(np.int32)
        numbers = len(points) + np.arange(len(edges))
        marked = MarkedEdges(edge_keys(edges), length.argsort().argsort(), numbers)
        points = np.concatenate([points, points[edges].mean(axis=1)])
        triangles = split(triangles, marked)[0]
