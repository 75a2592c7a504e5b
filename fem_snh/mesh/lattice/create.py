"""Create the mesh of a lattice."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from fem_snh.choices import LATTICE_PARTS, LATTICE_WEIGHTINGS
from fem_snh.errors import BadInput, bad_value, choose
from fem_snh.geometry.shapes import ClosedSurface, Shape
from fem_snh.mesh.gmsh_input import MeshData, PhysicalGroup
from fem_snh.mesh.lattice.carriers import carry, cover
from fem_snh.mesh.lattice.copies import node_copies
from fem_snh.mesh.lattice.crossings import sample_surface
from fem_snh.mesh.lattice.grid import Grid
from fem_snh.mesh.lattice.parts import FACES, Parts, joined, separate, without_fragments
from fem_snh.mesh.lattice.refine import refine
from fem_snh.mesh.lattice.samples import sample_shape
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
    if not np.isfinite(shape.bounds).all():
        raise BadInput("expected a body of finite size, no plane and no infinite cylinder")
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
