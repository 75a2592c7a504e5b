"""Create the mesh of a lattice, and find its nodes that lie at the same place."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from fem_snh.choices import LATTICE_PARTS, LATTICE_WEIGHTINGS
from fem_snh.errors import bad_value, choose
from fem_snh.geometry.shapes import ClosedSurface, Shape
from fem_snh.mesh.gmsh_input import MeshData, PhysicalGroup
from fem_snh.mesh.gmsh_model import NodeCopies
from fem_snh.mesh.lattice.carriers import carry, cover
from fem_snh.mesh.lattice.crossings import refine, sample_surface
from fem_snh.mesh.lattice.grid import Grid, Integers, sample_shape
from fem_snh.mesh.lattice.parts import FACES, Parts, joined, separate, without_fragments
from fem_snh.mesh.lattice.surface_nets import triangulate
from fem_snh.mesh.mesh import Mesh, distribute

_SIDES = ("xmin", "xmax", "ymin", "ymax", "zmin", "zmax")


def create(
    comm: MPI.Comm,
    body: Callable[[], Shape],
    cell: float,
    weighting: str = LATTICE_WEIGHTINGS[0],
    parts: str = LATTICE_PARTS[0],
    samples: int = 4,
    skin: int = 2,
) -> Mesh:
    """Create a hexahedral lattice that covers a body, distributed over the ranks. Collective.

    Its physical groups are ``body``, all cells; ``boundary``, all faces of one cell only; and
    ``xmin`` to ``zmax``, those of them on the sides of the lattice's box.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    body : callable
        Returns the body's shape. It is called on rank 0 only.
    cell : float
        Edge of a cell [length].
    weighting : {"fraction", "full"}
        Whether energy, mass and weight of a cell count by the part of it that the body fills.
    parts : {"separate", "joined"}
        Whether parts of the body that pass through one cell without touching have cells of their
        own there.
    samples : int
        A cell is sampled on this many cubes along each edge.
    skin : int
        The skin of a shape is triangulated on this many cubes along each edge of a cell.

    Raises
    ------
    BadInput
        On every rank, for an unknown word, a body without bounds, and cells that do not fit it.
    """
    choose("weighting", weighting, LATTICE_WEIGHTINGS)
    choose("parts", parts, LATTICE_PARTS)

    def make() -> MeshData:
        return lattice(body(), cell, weighting == "fraction", parts == "separate", samples, skin)

    return distribute(comm, "mesh.lattice", make)


def lattice(
    shape: Shape,
    cell: float,
    weighted: bool = True,
    divided: bool = True,
    samples: int = 4,
    divisions: int = 2,
) -> MeshData:
    """Return the mesh of a lattice; see `create`. Not collective."""
    grid = Grid.around(shape.bounds, cell)
    if isinstance(shape, ClosedSurface):
        found = sample_surface(shape, grid, samples)
        points, triangles = refine(shape.points, shape.triangles, cell)
    else:
        found, cut = sample_shape(shape, grid, samples)
        points, triangles = triangulate(shape, grid, cut, divisions)
    if not (found.coverage > 0.5).any():
        raise bad_value("cell", cell, "a smaller number: the body is thinner than the samples")
    found = cover(grid, found, points)
    parts = without_fragments((separate if divided else joined)(grid, found))
    skin = carry(grid, found, parts, points, triangles)
    fractions = parts.fractions if weighted else None
    x = grid.origin + grid.size * parts.corners
    copies = node_copies(grid, found.cells, parts)
    return MeshData(parts.nodes, x, "hexahedron", 1, _groups(parts), fractions, skin, copies)


def _groups(parts: Parts) -> list[PhysicalGroup]:
    """Return the groups of cells and of faces."""
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
