"""Which nodes of a lattice are in the same place as another one, in which the body's part lies."""

from __future__ import annotations

import numpy as np

from fem_snh.mesh.lattice.grid import Grid, Integers
from fem_snh.mesh.lattice.parts import Parts
from fem_snh.mesh.skin import NodeCopies

#: Reference coordinates of the nodes of a cell of degree 2, in halves of its edge, (27, 3).
_NODES = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
#: The cell's corners, in dolfinx's order, that make the entity on which each of these nodes is.
_CORNERS = np.array(
    [[all(p in (1, 2 * (v >> i & 1)) for i, p in enumerate(x)) for v in range(8)]
     for x in _NODES]
)  # fmt: skip
#: Distances that differ by less than this part of a cell are equal.
_ROUNDING = 1e-6


def node_copies(grid: Grid, cells: Integers, parts: Parts) -> NodeCopies:
    """Return the nodes of a lattice at which another part of the body lies than that of their cell.

    Of several nodes in the same place, those whose parts have the closest cube are at their own
    part; the others are copies.

    Parameters
    ----------
    grid : Grid
        The grid.
    cells : (cells of the grid, 3) int array
        The cells of the grid, whose rows ``parts.owner`` holds.
    parts : Parts
        The cells of the lattice.
    """
    _, place, count = np.unique(grid.key(parts.corners), return_inverse=True, return_counts=True)
    several = np.flatnonzero((count[place] > 1)[parts.nodes].any(axis=1))
    if not len(several):
        return NodeCopies(several, np.zeros((0, 27), bool))
    s = parts.labels.shape[1]
    cubes = (np.stack(np.meshgrid(*[np.arange(s)] * 3, indexing="ij"), axis=-1) + 0.5) / s
    away = np.linalg.norm(cubes.reshape(-1, 1, 3) - _NODES / 2, axis=2)
    own = parts.labels[parts.owner[several]].reshape(len(several), -1) == several[:, None] + 1
    distance = np.array([away[mine].min(axis=0, initial=np.inf) for mine in own])
    # A node is known by the corners of its entity: -1 for the others.
    corners = np.where(_CORNERS, parts.nodes[several][:, None], -1).reshape(-1, 8)
    node = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True)[1].ravel()
    at = 2 * cells[parts.owner[several]][:, None] + _NODES
    place = np.unique(at.reshape(-1, 3), axis=0, return_inverse=True)[1].ravel()
    closest = _smallest(node, distance.ravel())[node]
    copied = closest > _smallest(place, closest)[place] + _ROUNDING
    return NodeCopies(several, copied.reshape(-1, 27))


def _smallest(group: Integers, values: np.ndarray) -> np.ndarray:
    """Return the smallest value of each group."""
    found = np.full(group.max() + 1, np.inf)
    np.minimum.at(found, group, values)
    return found
