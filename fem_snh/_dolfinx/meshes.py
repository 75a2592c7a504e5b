"""Meshes: their distribution over the ranks, their entities, their geometry."""

from __future__ import annotations

import os
from collections.abc import Iterable
from inspect import signature
from math import comb
from pathlib import Path
from typing import Any

from mpi4py import MPI

import basix
import dolfinx
import dolfinx.io
import numpy as np
import ufl
from dolfinx.mesh import Mesh

from fem_snh.arrays import Array

#: The facets of each kind of cell.
FACET_OF = {
    "tetrahedron": "triangle",
    "hexahedron": "quadrilateral",
    "triangle": "interval",
    "quadrilateral": "interval",
}


def create_mesh(comm: MPI.Comm, cells: Array, x: Array, cell: str, degree: int) -> Mesh:
    """Distribute a mesh that some ranks provide; other ranks pass empty arrays. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    cells : (n, nodes per cell) int64
        Rows of ``x``, in dolfinx's order of nodes.
    x : (nodes, dim)
        Coordinates [m].
    cell : {"tetrahedron", "hexahedron", "triangle", "quadrilateral"}
        Kind of cell.
    degree : {1, 2}
        Degree of the geometry.
    """
    if hasattr(basix, "ufl"):  # since 0.7; before, elements are UFL's
        element = basix.ufl.element("Lagrange", cell, degree, shape=(x.shape[1],))
    else:
        ufl_cell = ufl.Cell(cell, geometric_dimension=x.shape[1])
        element = ufl.VectorElement(
            ufl.FiniteElement("Lagrange", ufl_cell, degree, variant="equispaced")
        )
    names = list(signature(dolfinx.mesh.create_mesh).parameters)
    options, rows = {}, np.ascontiguousarray(cells, dtype=np.int64)
    if "ghost_mode" in names:  # 0.5; later versions make no ghost cells by default
        options["ghost_mode"] = dolfinx.mesh.GhostMode.none
        # dolfinx tries to read an array as a list, and fails with a text of all arguments.
        rows = dolfinx.cpp.graph.AdjacencyList_int64(rows)
    geometry = [x, ufl.Mesh(element)]
    if names.index("x") == 3:  # since 0.10 the element comes before x
        geometry.reverse()
    # The threads of PT-Scotch match vertices in the order in which they find them: with several
    # threads, its default, the same mesh is partitioned differently from run to run.
    os.environ.setdefault("SCOTCH_PTHREAD_NUMBER", "1")
    return dolfinx.mesh.create_mesh(comm, rows, *geometry, **options)


def read_xdmf(comm: MPI.Comm, path: Path, grid: str) -> tuple[Array, Array, str, int]:
    """Return this rank's part of a grid, in the order of the file, for `create_mesh`. Collective.

    Returns
    -------
    cells, x, cell, degree
        As the arguments of `create_mesh`.

    Raises
    ------
    RuntimeError
        If the file cannot be read.
    """
    with dolfinx.io.XDMFFile(comm, str(path), "r") as file:
        shape, degree = file.read_cell_type(grid)
        cells, x = file.read_topology_data(grid), file.read_geometry_data(grid)
    return np.asarray(cells), np.asarray(x), str(shape).rpartition(".")[2], int(degree)


def read_xdmf_nodes(comm: MPI.Comm, path: Path, grid: str) -> Array:
    """Return this rank's part of a grid's entities, (n, nodes of an entity). Collective."""
    with dolfinx.io.XDMFFile(comm, str(path), "r") as file:
        return np.asarray(file.read_topology_data(grid))


def read_xdmf_tags(domain: Mesh, path: Path, grid: str, dim: int) -> tuple[Array, Array]:
    """Return a grid's tagged local entities, ghosts included, and their tags. Collective."""
    domain.topology.create_entities(dim)
    for end in (0, domain.topology.dim):
        domain.topology.create_connectivity(dim, end)
    with dolfinx.io.XDMFFile(domain.comm, str(path), "r") as file:
        tags = file.read_meshtags(domain, grid)
    return np.asarray(tags.indices), np.asarray(tags.values)


def write_xdmf(
    domain: Mesh, path: Path, tags: Iterable[tuple[str, int, Array, int]], notes: dict[str, str]
) -> None:
    """Write a mesh, tags of its entities and notes to an XDMF file. Collective.

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh; its name becomes "mesh".
    path : Path
        The file; the numbers are in a file beside it, with the suffix .h5.
    tags : iterable of (grid, dimension, local entities, tag)
        Ghosts may be among the entities.
    notes : dict
        Names and values of the file's ``Information``.
    """
    domain.name = "mesh"
    with dolfinx.io.XDMFFile(domain.comm, str(path), "w") as file:
        file.write_mesh(domain)
        for grid, dim, entities, tag in tags:
            domain.topology.create_connectivity(dim, domain.topology.dim)
            values = np.full(len(entities), tag, np.int32)
            written = dolfinx.mesh.meshtags(domain, dim, entities, values)
            written.name = grid
            geometry = (
                [domain.geometry] if "write_meshtags" in vars(type(file)) else []
            )  # since 0.7
            file.write_meshtags(written, *geometry)
        for name, value in notes.items():
            file.write_information(name, value)


def _rows(table: Any, width: int) -> Array:
    """Return a dofmap or connectivity as a (rows, width) array, also without rows."""
    # Connectivities are adjacency lists; so are the dofmaps of 0.5 (arrays since 0.7).
    return np.asarray(getattr(table, "array", table)).reshape(-1, width)


def gmsh_permutation(cell: str, nodes: int) -> Array:
    """Return p with nodes_dolfinx[i] = nodes_gmsh[p[i]]."""
    return np.asarray(dolfinx.cpp.io.perm_gmsh(getattr(dolfinx.mesh.CellType, cell), nodes))


def num_owned(domain: Mesh, dim: int | None = None) -> int:
    """Return the number of entities of this dimension (default: cells) that this rank owns."""
    dim = domain.topology.dim if dim is None else dim
    domain.topology.create_entities(dim)
    return int(domain.topology.index_map(dim).size_local)


def num_cells(domain: Mesh) -> int:
    """Return the number of cells on all ranks."""
    return int(domain.topology.index_map(domain.topology.dim).size_global)


def num_nodes_of_degree(domain: Mesh, degree: int) -> int:
    """Return the number of nodes on all ranks of Lagrange elements; degree 0: cells. Collective."""
    topology, total = domain.topology, 0
    if degree == 0:
        return num_cells(domain)
    simplex = cell_name(domain) in ("triangle", "tetrahedron")
    for dim in range(topology.dim + 1):
        if inside := comb(degree - 1, dim) if simplex else (degree - 1) ** dim:
            topology.create_entities(dim)
            total += inside * topology.index_map(dim).size_global
    return int(total)


def input_cells(domain: Mesh) -> Array:
    """Return the row of each local cell in the input of `create_mesh`, (local cells,)."""
    return np.asarray(domain.topology.original_cell_index)


def input_vertices(domain: Mesh, dim: int) -> Array:
    """Return input node numbers of each local entity's vertices, (entities, vertices)."""
    topology, cell_dim = domain.topology, domain.topology.dim
    for d in (dim, cell_dim):
        topology.create_entities(d)
        topology.create_connectivity(d, 0)
    simplex = cell_name(domain) in ("tetrahedron", "triangle")
    corners = [d + 1 if simplex else 2**d for d in range(cell_dim + 1)]
    cells = _rows(topology.connectivity(cell_dim, 0), corners[cell_dim])
    nodes = _geometry_rows(domain)[:, : corners[cell_dim]]  # the vertices come first
    index_map = topology.index_map(0)
    number = np.empty(index_map.size_local + index_map.num_ghosts, dtype=np.int64)
    number[cells] = np.asarray(domain.geometry.input_global_indices)[nodes]
    return number[_rows(topology.connectivity(dim, 0), corners[dim])]


def input_nodes(domain: Mesh) -> Array:
    """Return the row of each of this rank's geometry nodes in the input of `create_mesh`."""
    return np.asarray(domain.geometry.input_global_indices, dtype=np.int64)


def cell_vertices(domain: Mesh) -> Array:
    """Return the vertices of each owned cell by global numbers, (cells, corners) int64."""
    topology = domain.topology
    topology.create_connectivity(topology.dim, 0)
    vertices = _rows(
        topology.connectivity(topology.dim, 0), len(reference_corners(cell_name(domain)))
    )
    vertices = vertices[: num_owned(domain)]
    numbers = topology.index_map(0).local_to_global(vertices.ravel().astype(np.int32))
    return np.asarray(numbers, dtype=np.int64).reshape(vertices.shape)


def cell_facets(domain: Mesh) -> Array:
    """Return the facets of each owned cell by local numbers, (cells, facets) int32."""
    topology, dim = domain.topology, domain.topology.dim
    topology.create_entities(dim - 1)
    topology.create_connectivity(dim, dim - 1)
    facets = _rows(topology.connectivity(dim, dim - 1), len(reference_facets(cell_name(domain))))
    return facets[: num_owned(domain)]


def facet_reflections(domain: Mesh) -> Array:
    """Return which facets of owned cells are reflected, (cells, facets) bool. Collective.

    The vertices of a reflected facet are in the opposite order of their global numbers.
    """
    domain.topology.create_entity_permutations()
    # 0.9 wraps the topology
    topology = getattr(domain.topology, "_cpp_object", domain.topology)
    facets = len(reference_facets(cell_name(domain)))
    reflected = np.asarray(topology.get_facet_permutations()).reshape(-1, facets) & 1 > 0
    return reflected[: num_owned(domain)]


def _cell_type(cell: str) -> basix.CellType:
    """Return the basix.CellType of this name."""
    return getattr(basix.CellType, cell)


def reference_facets(cell: str) -> Array:
    """Return the vertices of the reference cell's facets, (facets, corners of a facet)."""
    return np.asarray(basix.topology(_cell_type(cell))[-2])


def reference_edges(cell: str) -> Array:
    """Return the vertices of the reference cell's edges, (edges, 2)."""
    return np.asarray(basix.topology(_cell_type(cell))[1])


def cell_name(domain: Mesh) -> str:
    """Return "tetrahedron", "hexahedron", "triangle" or "quadrilateral"."""
    return str(domain.topology.cell_name())


def reference_corners(cell: str) -> Array:
    """Return the vertices of the reference cell, (corners, dim)."""
    return np.asarray(basix.geometry(_cell_type(cell)))


def geometry_dofs(domain: Mesh) -> Array:
    """Return each owned cell's rows of `geometry_x`, (cells, nodes per cell) int32."""
    return _geometry_rows(domain)[: num_owned(domain)]


def geometry_x(domain: Mesh) -> Array:
    """Return the reference coordinates [m] of the geometry's nodes, (local nodes, 3)."""
    return np.asarray(domain.geometry.x)


def geometry_degree(domain: Mesh) -> int:
    """Return the polynomial degree of the geometry."""
    return int(_only(domain.geometry, "cmap").degree)


def _geometry_rows(domain: Mesh) -> Array:
    nodes = _only(domain.geometry, "cmap").create_dof_layout().num_dofs
    return _rows(_only(domain.geometry, "dofmap"), nodes)


def _only(geometry: Any, name: str) -> Any:
    """Return an attribute of the mesh's only kind of cell; dolfinx stores one for each kind."""
    # 0.11 has a list under the plural
    several = getattr(geometry, name + "s", None)
    return several[0] if isinstance(several, list) else getattr(geometry, name)


def coordinates(domain: Mesh) -> Any:
    """Return the UFL SpatialCoordinate: the reference coordinates [m]."""
    return ufl.SpatialCoordinate(domain)


def exterior_facets(domain: Mesh) -> tuple[Array, Array, Array]:
    """Return the facets on the boundary of the body whose cells this rank owns.

    Returns
    -------
    facets : (n,) int32
        Local numbers, sorted.
    cells : (n,) int32
        The cell of each facet.
    local_facets : (n,) int32
        The facet's number in its reference cell.
    """
    topology, dim = domain.topology, domain.topology.dim
    topology.create_connectivity(dim - 1, dim)
    topology.create_connectivity(dim, dim - 1)
    facets = np.sort(np.asarray(dolfinx.mesh.exterior_facet_indices(topology), dtype=np.int32))
    cells_of = topology.connectivity(dim - 1, dim)
    # An exterior facet has one cell.
    cells = np.asarray(cells_of.array)[np.asarray(cells_of.offsets)[facets]]
    facets_of = _rows(topology.connectivity(dim, dim - 1), len(reference_facets(cell_name(domain))))
    owned = cells < num_owned(domain)
    facets, cells = facets[owned], cells[owned]
    return facets, cells, (facets_of[cells] == facets[:, None]).argmax(axis=1).astype(np.int32)


def facet_maps(cell: str) -> tuple[Array, Array]:
    """Return the affine maps x = origin + s tangents of the reference facets into the cell.

    Returns
    -------
    origins : (facets, dim)
        The images of the reference facet's origin.
    tangents : (facets, dim - 1, dim)
        The derivatives by the facet's coordinates.
    """
    corners = reference_corners(cell)[reference_facets(cell)]  # (facets, corners of each, dim)
    return corners[:, 0], corners[:, 1 : corners.shape[2]] - corners[:, :1]


def bounding_box(domain: Mesh) -> Array:
    """Return the smallest and largest reference coordinates of this rank's cells, (2, 3).

    Without cells they are inf and -inf.
    """
    x = geometry_x(domain)[geometry_dofs(domain).ravel()]
    return np.stack([x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)])
