"""Which cell of a lattice carries each point of the body's surface."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fem_snh.mesh.gmsh_model import Skin
from fem_snh.mesh.lattice.grid import Array, Grid, Integers, Samples, cells_of_box, sorted_samples
from fem_snh.mesh.lattice.parts import Parts
from fem_snh.mesh.lattice.surface_nets import Triangles

#: Cells that the body fills by less than this are left out: a cell's stiffness is proportional to
#: the fraction, and so is the smallest eigenvalue of the matrix.
SMALLEST_FRACTION = 1e-3
#: Distance, in cells, by which a point may be outside of its cell: a surface on the side of a
#: cell, also with the digits of single precision in STL files, needs no cell beyond that side.
_TOLERANCE = 1e-2
#: Points whose samples are compared together, which bounds the memory.
_BATCH = 20_000


def cover(grid: Grid, samples: Samples, points: Array) -> Samples:
    """Return the samples of a lattice in whose cells all points of a surface lie.

    Cells that the body fills by less than `SMALLEST_FRACTION` are kept, with that fraction, only if
    a point lies in them that is in no other cell up to a hundredth of a cell.

    Parameters
    ----------
    grid : Grid
        The grid.
    samples : Samples
        What the body fills.
    points : (n, 3) array
        Points of its surface [length].
    """
    keep = samples.fractions >= SMALLEST_FRACTION
    cells, coverage = samples.cells[keep], samples.coverage[keep]
    xi = (points - grid.origin) / grid.size
    alone = np.ones(len(xi), dtype=bool)
    keys = grid.key(cells)
    for step in cells_of_box(np.full(3, -1), np.full(3, 2)):
        alone &= ~np.isin(grid.key(_index(grid, xi + _TOLERANCE * step)), keys)
    own = _index(grid, xi[alone])
    if not len(own):
        return Samples(cells, coverage)
    _, first, which = np.unique(grid.key(own), return_index=True, return_inverse=True)
    own = own[first]
    s = coverage.shape[1]
    added = np.zeros((len(own), s, s, s), dtype=np.float32)
    row, found = grid.rows(samples.cells, own)
    added[row] = samples.coverage[found]
    cube = np.clip(((xi[alone] - own[which]) * s).astype(np.int64), 0, s - 1)
    missing = np.maximum(SMALLEST_FRACTION - added.mean(axis=(1, 2, 3)), 0) * s**3
    several = np.bincount(which)
    np.add.at(added, (which, *cube.T), (missing / several)[which])
    cells = np.concatenate([cells, own])
    return sorted_samples(grid, cells, np.concatenate([coverage, added]))


def carry(grid: Grid, samples: Samples, parts: Parts, points: Array, triangles: Triangles) -> Skin:
    """Return the skin of a surface: each point with a cell of the lattice in which it lies.

    Of several parts in one cell, a point belongs to that with the cube closest to the place just
    below the surface.

    Parameters
    ----------
    grid, samples, parts
        The lattice.
    points, triangles : (n, 3) array, (m, 3) int array
        The surface, with outward normals.
    """
    s = samples.coverage.shape[1]
    xi = (points - grid.origin) / grid.size
    below = xi - 0.5 / s * _normals(points, triangles)
    labels = parts.labels.reshape(len(samples.cells), -1)
    place = (cells_of_box(np.zeros(3, np.int64), np.full(3, s)) + 0.5) / s
    closest, carrier = np.full(len(xi), np.inf), np.zeros(len(xi), dtype=np.int64)
    # Most points are in a cell with one part only.
    point, row = grid.rows(samples.cells, _index(grid, xi))
    single = np.bincount(parts.owner, minlength=len(labels))[row] == 1
    carrier[point[single]] = labels.max(axis=1)[row[single]]
    several = np.flatnonzero(carrier == 0)
    for step in cells_of_box(np.full(3, -1), np.full(3, 2)):
        cell = _index(grid, xi + _TOLERANCE * step)
        point, row = grid.rows(samples.cells, cell[several])
        point = several[point]
        for start in range(0, len(point), _BATCH):
            p, r = point[start : start + _BATCH], row[start : start + _BATCH]
            distance = np.linalg.norm((below[p] - cell[p])[:, None] - place, axis=2)
            distance[labels[r] == 0] = np.inf
            best, every = distance.argmin(axis=1), np.arange(len(p))
            better = distance[every, best] < closest[p]
            closest[p[better]] = distance[every, best][better]
            carrier[p[better]] = labels[r, best][better]
    lost = np.flatnonzero(carrier == 0)
    if len(lost):  # on a fragment that the lattice leaves out
        centres = samples.cells[parts.owner] + 0.5
        carrier[lost] = 1 + cKDTree(centres).query(xi[lost])[1]
    return Skin(points, triangles.astype(np.int32), carrier - 1)


def _index(grid: Grid, xi: Array) -> Integers:
    """Return the cells (n, 3) of points (n, 3) in units of a cell, those of the grid outside."""
    return np.clip(np.floor(xi).astype(np.int64), 0, grid.shape - 1)


def _normals(points: Array, triangles: Triangles) -> Array:
    """Return the unit normals of a surface at its points, (n, 3): means by the triangles' areas."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    sums = [np.bincount(triangles.ravel(), np.repeat(area[:, i], 3), len(points)) for i in range(3)]
    normals = np.stack(sums, axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
