"""Meshes of a body: a lattice of hexahedra that covers it, and tetrahedra that fill it."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_matrix
from scipy.spatial import cKDTree

from fem_snh.arrays import Array
from fem_snh.choices import LATTICE_WEIGHTINGS
from fem_snh.errors import bad_value, choose
from fem_snh.geometry.shapes import ClosedSurface, Shape
from fem_snh.geometry.shapes.closed_surface import enclosed_volume
from fem_snh.geometry.surface_nets import (
    Grid,
    Integers,
    Triangles,
    cells_of_box,
    surface_on,
    triangulate,
)
from fem_snh.mesh.gmsh_input import fill
from fem_snh.mesh.gmsh_model import MeshData, NodeCopies, PhysicalGroup, Skin
from fem_snh.mesh.lattice_parts import FACES, Parts, keep_closest, separate, without_fragments
from fem_snh.mesh.lattice_samples import Samples, refine, sample_shape, sorted_samples
from fem_snh.mesh.mesh import Mesh, distribute

_SIDES = ("xmin", "xmax", "ymin", "ymax", "zmin", "zmax")
#: Cells that the body fills by less than this are left out: a cell's stiffness is proportional to
#: the fraction, and so is the smallest eigenvalue of the matrix.
SMALLEST_FRACTION = 1e-3
#: Distance, in cells, by which a point may be outside of its cell: a surface on the side of a
#: cell, also with the digits of single precision in STL files, needs no cell beyond that side.
_TOLERANCE = 1e-2
#: Largest relative error of a surface's sampled volume; 0.04 for a flat ball 1.5 samples thick.
_SAMPLING_ERROR = 0.05
#: Points whose samples are compared together, which bounds the memory.
_BATCH = 20_000
#: Sweeps of smoothing, after which triangles hardly change: in a club (a capsule and a ball) the
#: worst triangle's quality rises from 1e-8 to 0.27, the worst tetrahedron's from 1e-6 to 0.19.
_SWEEPS = 5
#: Newton steps back to the surface after each sweep; each step squares the distance.
_STEPS = 3


def create(
    comm: MPI.Comm,
    body: Callable[[], Shape],
    cell: float,
    weighting: str = LATTICE_WEIGHTINGS[0],
    samples: int = 4,
    skin: int = 2,
) -> Mesh:
    """Create a hexahedral lattice that covers a body, distributed over the ranks. Collective.

    The physical groups are ``body``, all cells; ``boundary``, all faces of one cell only; and
    ``xmin`` to ``zmax``, the boundary faces on the sides of the lattice's box.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    body : callable
        Returns the body's shape. It is called on rank 0 only.
    cell : float
        Edge of a cell [length].
    weighting : {"fraction", "full"}
        Whether a cell's energy, mass and weight are multiplied by its filled fraction.
    samples : int
        A cell is sampled on this many cubes along each edge.
    skin : int
        The skin of a shape is triangulated on this many cubes along each edge of a cell.

    Raises
    ------
    BadInput
        On every rank, for an unknown weighting, a body without bounds, and an unsuitable ``cell``.
    """
    choose("weighting", weighting, LATTICE_WEIGHTINGS)

    def make() -> MeshData:
        return lattice(body(), cell, weighting == "fraction", samples, skin)

    return distribute(comm, "mesh.lattice", make)


def lattice(
    shape: Shape,
    cell: float,
    weighted: bool = True,
    samples: int = 4,
    divisions: int = 2,
) -> MeshData:
    """Return a lattice; ``divisions`` is the ``skin`` of `create`. Not collective."""
    grid = Grid.around(shape.bounds, cell)
    found, cut = sample_shape(shape, grid, samples)
    if isinstance(shape, ClosedSurface):
        points, triangles = refine(shape.points, shape.triangles, cell)
    else:
        points, triangles = triangulate(shape, grid, cut, divisions)
    if not (found.coverage > 0.5).any():
        raise bad_value("cell", cell, "a smaller number: the body is thinner than the samples")
    if isinstance(shape, ClosedSurface):
        # The closest triangle decides what is inside, which is wrong where parts overlap.
        exact = enclosed_volume(shape.points, shape.triangles)
        filled = float(found.fractions.sum()) * cell**3
        if not abs(filled - exact) <= _SAMPLING_ERROR * exact:
            accepted = "a smaller number, or a surface whose parts do not overlap"
            raise bad_value(
                "cell", cell, f"{accepted}: it encloses {exact:.4g}, and the samples {filled:.4g}"
            )
    found = cover(grid, found, points)
    parts = without_fragments(separate(grid, found))
    skin = carry(grid, found, parts, points, triangles)
    fractions = parts.fractions if weighted else None
    x = grid.origin + grid.size * parts.corners
    copies = node_copies(grid, found.cells, parts)
    return MeshData(parts.nodes, x, "hexahedron", 1, _groups(parts), fractions, skin, copies)


def _groups(parts: Parts) -> list[PhysicalGroup]:
    """Return the physical groups that `create` lists."""
    faces = parts.nodes[:, FACES].reshape(-1, 4)
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = first[count == 1]
    groups = [
        PhysicalGroup("body", 3, 1, np.arange(len(parts.nodes))),
        PhysicalGroup("boundary", 2, 1, faces[outer]),
    ]
    for number, name in enumerate(_SIDES):
        side = outer[outer % 6 == number]
        place = parts.corners[faces[side]][:, 0, number // 2]
        end = place.max() if number % 2 else place.min()
        groups.append(PhysicalGroup(name, 2, number + 2, faces[side[place == end]]))
    return groups


#: Reference coordinates of the nodes of a cell of degree 2, in halves of its edge, (27, 3).
_NODES = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
#: Which corners of the cell span the entity on which each of these nodes is, (27, 8) bool.
_CORNERS = np.array(
    [[all(p in (1, 2 * (v >> i & 1)) for i, p in enumerate(x)) for v in range(8)]
     for x in _NODES]
)  # fmt: skip
#: Distances are equal up to this fraction of a cell's edge.
_ROUNDING = 1e-6


def node_copies(grid: Grid, cells: Integers, parts: Parts) -> NodeCopies:
    """Return which nodes of a lattice are copies; see `NodeCopies`.

    Of several nodes at one position, the nodes whose parts have the closest cube are no copies.

    Parameters
    ----------
    grid : Grid
        The grid.
    cells : (cells of the grid, 3) int array
        The filled cells of the grid, of which ``parts.owner`` are rows.
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
    # The corners of its entity identify a node: -1 for other corners.
    corners = np.where(_CORNERS, parts.nodes[several][:, None], -1).reshape(-1, 8)
    node = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True)[1].ravel()
    at = 2 * cells[parts.owner[several]][:, None] + _NODES
    place = np.unique(at.reshape(-1, 3), axis=0, return_inverse=True)[1].ravel()
    closest = _smallest(node, distance.ravel())[node]
    copied = closest > _smallest(place, closest)[place] + _ROUNDING
    return NodeCopies(several, copied.reshape(-1, 27))


def _smallest(group: Integers, values: np.ndarray) -> np.ndarray:
    """Return the smallest of the ``values`` (n,) in each group 0, 1, ...; ``group`` is (n,)."""
    found = np.full(group.max() + 1, np.inf)
    np.minimum.at(found, group, values)
    return found


def cover(grid: Grid, samples: Samples, points: Array) -> Samples:
    """Return samples whose cells contain all points of a surface.

    Cells filled by less than `SMALLEST_FRACTION` are included, with that fraction, only if they
    contain a point that is not within ``_TOLERANCE`` of another cell.

    Parameters
    ----------
    grid : Grid
        The grid.
    samples : Samples
        The cells that the body fills.
    points : (n, 3) array
        Points of the body's surface [length].
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
    """Return the skin: the surface, and the lattice cell that contains each point.

    If a grid cell has several parts, a point belongs to the part that has the cube (of
    `Samples.coverage`) closest to the point, moved inwards by half a cube.

    Parameters
    ----------
    grid : Grid
    samples : Samples
    parts : Parts
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
            keep_closest(distance, labels[r], p, closest, carrier)
    lost = np.flatnonzero(carrier == 0)
    if len(lost):  # on a fragment that the lattice leaves out
        centres = samples.cells[parts.owner] + 0.5
        carrier[lost] = 1 + cKDTree(centres).query(xi[lost])[1]
    return Skin(points, triangles.astype(np.int32), carrier - 1)


def _index(grid: Grid, xi: Array) -> Integers:
    """Return the grid cells (n, 3) of points (n, 3) in cell units; outside, the closest cell."""
    return np.clip(np.floor(xi).astype(np.int64), 0, grid.shape - 1)


def _normals(points: Array, triangles: Triangles) -> Array:
    """Return unit normals at a surface's points, (n, 3): area-weighted means over triangles."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    sums = [np.bincount(triangles.ravel(), np.repeat(area[:, i], 3), len(points)) for i in range(3)]
    normals = np.stack(sums, axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


def create_tetrahedra(comm: MPI.Comm, body: Callable[[], Shape], size: float) -> Mesh:
    """Fill a body with tetrahedra by gmsh. Collective.

    The surface of a shape is triangulated first, with edges of about the given length. A file's
    surface is taken as it is: the quality of its triangles limits that of the tetrahedra. The
    physical groups are ``body``, all cells, and ``boundary``, all facets of the boundary.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    body : callable
        Returns the body's shape. It is called on rank 0 only.
    size : float
        Length of the edges [length].

    Raises
    ------
    BadInput
        On every rank, for a body without bounds, an unsuitable size, and if gmsh fails.
    """
    return distribute(comm, "mesh.surface", lambda: tetrahedra(body(), size))


def tetrahedra(shape: Shape, size: float) -> MeshData:
    """Return the mesh of a body; see `create_tetrahedra`. Not collective."""
    grid = Grid.around(shape.bounds, size, "size")
    if isinstance(shape, ClosedSurface):
        return fill(shape.points, shape.triangles, size)
    points, triangles = surface_on(shape, grid)
    return fill(_smoothed(shape, points, triangles), triangles, size)


def _smoothed(shape: Shape, x: Array, triangles: Triangles) -> Array:
    """Return the points, moved to the means of their neighbours and back to the surface."""
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ones = np.ones(len(edges))
    neighbours = coo_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(len(x), len(x))).tocsr()
    count = np.asarray(neighbours.sum(axis=1))
    for _ in range(_SWEEPS):
        x = neighbours @ x / count
        for _ in range(_STEPS):
            d, g, _ = shape.evaluate(x)
            square = np.einsum("ni,ni->n", g, g)
            x = x - np.divide(d, square, out=np.zeros_like(d), where=square > 0)[:, None] * g
    return x
