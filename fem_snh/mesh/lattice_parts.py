"""The cells and nodes of a lattice: cells share nodes where the solid connects them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fem_snh.arrays import Array
from fem_snh.geometry.surface_nets import CORNERS, Grid, Integers
from fem_snh.mesh.lattice_samples import Samples

Labels = npt.NDArray[np.int32]

#: Corners of the faces of a cell, in dolfinx's order.
FACES = np.array(
    [[0, 2, 4, 6], [1, 3, 5, 7], [0, 1, 4, 5], [2, 3, 6, 7], [0, 1, 2, 3], [4, 5, 6, 7]]
)
#: Largest number of cells that share a face.
_CELLS_AT_A_FACE = 3
#: Steps to the six cells around: down and up along each axis.
_STEPS = np.repeat(np.eye(3, dtype=np.int64), 2, axis=0) * np.array([-1, 1] * 3)[:, None]
#: A cube is inside of the solid if it is filled by more than this: its centre is inside.
_INSIDE = 0.5


class Parts(NamedTuple):
    """The cells of a lattice: one for each part of the solid in each cell of the grid.

    Attributes
    ----------
    labels : (cells of the grid, s, s, s) int32 array
        For each cube (s along an edge of a cell) the number of its lattice cell, counted from 1;
        0 outside of the solid.
    owner : (n,) int array
        The grid cell of each lattice cell, as a row of `Samples`.
    fractions : (n,) array
        The fraction of each lattice cell that its part of the solid fills.
    nodes : (n, 8) int array
        The nodes of each lattice cell in dolfinx's order.
    corners : (nodes, 3) int array
        The position of each node: the lowest corner of grid cell (i, j, k) is (i, j, k).
    """

    labels: Labels
    owner: Integers
    fractions: Array
    nodes: Integers
    corners: Integers


def separate(grid: Grid, samples: Samples) -> Parts:
    """Return one lattice cell for each connected part of the solid within each grid cell.

    Parts of neighbouring cells are connected if cubes on both sides of the common face are inside.
    Connected cells share the four nodes of that face. Parts are always separate if their distance
    is at least the edge of a cube.

    References
    ----------
    Teran et al. 2005, Creating and simulating skeletal muscle from the visible human data set,
    section 4 (duplicated cells); Nesme et al. 2009, Preserving topology and elasticity for embedded
    deformable models, section 3; Smith et al. 2018, section 6 (non-manifold lattices).
    """
    inside = _inside(samples)
    along_cells = np.zeros((3, 3, 3, 3), dtype=bool)
    along_cells[1] = ndimage.generate_binary_structure(3, 1)  # cubes of one cell, by their faces
    labels, n = ndimage.label(inside, along_cells, output=np.int32)
    while True:
        parts = _connected(grid, samples, labels, n)
        joined = _around_a_face(parts)
        if joined is None:
            return parts
        n, number = joined
        labels = np.concatenate([[0], number + 1]).astype(np.int32)[labels]


def _connected(grid: Grid, samples: Samples, labels: Labels, n: int) -> Parts:
    """Return the n parts of these labels; their cells share nodes where parts touch."""
    part = np.flatnonzero(labels.ravel())
    owner = np.zeros(n, dtype=np.int64)
    owner[labels.ravel()[part] - 1] = part // labels[0].size
    fractions = _fractions(samples, labels, owner, n)

    pairs = np.concatenate([_touching(grid, samples, labels), _nearest(grid, samples, labels)])
    a, b = _common_corners(samples.cells[owner], pairs)
    same = coo_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(8 * n, 8 * n))
    count, node = connected_components(same, directed=False)
    corners = np.empty((count, 3), dtype=np.int64)
    corners[node] = (samples.cells[owner][:, None] + CORNERS).reshape(-1, 3)
    return Parts(labels, owner, fractions, node.reshape(n, 8).astype(np.int64), corners)


def _around_a_face(parts: Parts) -> tuple[int, Integers] | None:
    """Join parts where four cells share a face, which no dolfinx mesh can have.

    The two parts on the same side of the face are connected just beyond it. Return the number of
    parts and each part's new number; None if no parts are joined.
    """
    n, faces = len(parts.nodes), np.sort(parts.nodes[:, FACES].reshape(-1, 4), axis=1)
    _, face, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    crowded = np.flatnonzero(count[face.ravel()] > _CELLS_AT_A_FACE)
    if not len(crowded):
        return None
    cell, face = crowded // 6, face.ravel()[crowded]
    # Parts are joined with other parts of their grid cell at the same face.
    _, group = np.unique(np.stack([face, parts.owner[cell]], axis=1), axis=0, return_inverse=True)
    joined = coo_matrix(
        (np.ones(len(cell), dtype=np.int8), (cell, n + group.ravel())), shape=(n + len(cell),) * 2
    )
    number = connected_components(joined, directed=False)[1][:n]
    kept, number = np.unique(number, return_inverse=True)
    return len(kept), number


def _inside(samples: Samples) -> npt.NDArray[np.bool_]:
    """Return which cubes are inside; in a cell without any, the cube that is filled most."""
    coverage = samples.coverage.reshape(len(samples.cells), -1)
    inside = coverage > _INSIDE
    none = np.flatnonzero(~inside.any(axis=1))
    inside[none, coverage[none].argmax(axis=1)] = True
    return inside.reshape(samples.coverage.shape)


def _fractions(samples: Samples, labels: Labels, owner: Integers, n: int) -> Array:
    """Return each part's share of its grid cell's fraction, by the coverage of cubes, (n,)."""
    cover = np.bincount(labels.ravel(), weights=samples.coverage.ravel(), minlength=n + 1)[1:]
    total = np.bincount(owner, weights=cover, minlength=len(samples.cells))
    return samples.fractions[owner] * cover / total[owner]


def _touching(grid: Grid, samples: Samples, labels: Labels) -> Integers:
    """Return the pairs (n, 2) of parts that have cubes on both sides of a common face."""
    found = []
    for axis in range(3):
        low, high = grid.rows(samples.cells, samples.cells + _STEPS[2 * axis + 1])
        p = np.take(labels[low], -1, axis=axis + 1).astype(np.int64).ravel()
        q = np.take(labels[high], 0, axis=axis + 1).astype(np.int64).ravel()
        both, n = (p > 0) & (q > 0), labels.max() + 1
        found.append(np.stack(np.divmod(np.unique(p[both] * n + q[both]), n), axis=1) - 1)
    return np.concatenate(found)


def _nearest(grid: Grid, samples: Samples, labels: Labels) -> Integers:
    """Return pairs (n, 2): each part without a cube whose centre is inside, and a neighbour.

    The neighbour is the part with the closest cube in the six cells around.
    """
    s, cubes = labels.shape[1], labels[0].size
    coverage = samples.coverage.reshape(-1, cubes)
    thin = coverage.max(axis=1) <= _INSIDE
    rows = np.flatnonzero(thin)
    place = np.stack(np.unravel_index(np.arange(cubes), labels.shape[1:]), axis=1)
    mine = place[coverage[rows].argmax(axis=1)]
    closest, partner = np.full(len(rows), np.inf), np.zeros(len(rows), dtype=np.int64)
    for step in _STEPS:
        found, row = grid.rows(samples.cells, samples.cells[rows] + step)
        found, row = found[~thin[row]], row[~thin[row]]
        label = labels[row].reshape(len(row), cubes)
        away = np.linalg.norm(place + s * step - mine[found, None], axis=2)
        keep_closest(away, label, found, closest, partner)
    own = labels[rows].reshape(len(rows), cubes).max(axis=1)
    return np.stack([own, partner], axis=1)[partner > 0].astype(np.int64) - 1


def keep_closest(
    distance: Array, labels: Array, rows: Integers, closest: Array, label: Integers
) -> None:
    """Keep the label of the closest cube of each row, where it is closer than the known one.

    Parameters
    ----------
    distance, labels : (n, cubes)
        The distances of cubes, and their labels; 0 is that of no part.
    rows : (n,) int
        Different rows of `closest` and ``label``, which are updated in place.
    """
    distance = np.where(labels == 0, np.inf, distance)
    best, every = distance.argmin(axis=1), np.arange(len(rows))
    better = distance[every, best] < closest[rows]
    closest[rows[better]] = distance[every, best][better]
    label[rows[better]] = labels[every, best][better]


def _common_corners(cells: Integers, pairs: Integers) -> tuple[Integers, Integers]:
    """Return the common corners of the cells of pairs of parts p, q, as 8 p + v and 8 q + w.

    v and w are the corner's numbers in the two cells.
    """
    p, q = pairs.T
    first, second = [], []
    for v, corner in enumerate(CORNERS):
        other = cells[p] + corner - cells[q]
        common = np.all((other >= 0) & (other <= 1), axis=1)
        first.append(8 * p[common] + v)
        second.append(8 * q[common] + other[common] @ np.array([1, 2, 4]))
    return np.concatenate(first), np.concatenate(second)


def without_fragments(parts: Parts) -> Parts:
    """Return the parts without disconnected pieces that fill less than one cell.

    The pieces are samples of something thinner than a cube, and would float freely. The largest
    piece always remains.
    """
    n = len(parts.nodes)
    pairs = coo_matrix(
        (np.ones(8 * n, dtype=np.int8), (np.repeat(np.arange(n), 8), parts.nodes.ravel())),
        shape=(n, len(parts.corners)),
    ).tocsr()
    _, piece = connected_components(pairs @ pairs.T, directed=False)
    volume = np.bincount(piece, weights=parts.fractions)
    kept = (volume >= min(1.0, volume.max()))[piece]
    if kept.all():
        return parts
    number = np.where(kept, np.cumsum(kept), 0)
    nodes, inverse = np.unique(parts.nodes[kept], return_inverse=True)
    return Parts(
        np.concatenate([[0], number]).astype(np.int32)[parts.labels],
        parts.owner[kept],
        parts.fractions[kept],
        inverse.reshape(-1, 8),
        parts.corners[nodes],
    )
