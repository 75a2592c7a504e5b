"""Meshes: distribution, entities, geometry, where dolfinx versions differ."""

from __future__ import annotations

from inspect import signature
from typing import Any

from mpi4py import MPI

import basix
import dolfinx
import numpy as np
import ufl

from fem_snh._dolfinx.common import _rows

Array = np.ndarray


def create_mesh(comm: MPI.Comm, cells: Array, x: Array, cell: str, degree: int) -> Any:
    """Distribute a mesh given on some ranks (others pass arrays of zero rows). Collective.

    Args:
        cells: (n, nodes per cell) int64 input node numbers, in dolfinx's order of nodes.
        x: (nodes, 3) coordinates [length]; node i is row i.
        cell: "tetrahedron" or "hexahedron".
        degree: 1 or 2, of the geometry.
    """
    if hasattr(basix, "ufl"):  # since 0.7
        element = basix.ufl.element("Lagrange", cell, degree, shape=(3,))
    else:
        ufl_cell = ufl.Cell(cell, geometric_dimension=3)
        element = ufl.VectorElement(
            ufl.FiniteElement("Lagrange", ufl_cell, degree, variant="equispaced")
        )
    names = list(signature(dolfinx.mesh.create_mesh).parameters)
    options = {}
    if "ghost_mode" in names:  # 0.5; later versions make no ghost cells unless asked to
        options["ghost_mode"] = dolfinx.mesh.GhostMode.none
    geometry = [x, ufl.Mesh(element)]
    if names.index("x") == 3:  # since 0.10
        geometry.reverse()
    cells = np.ascontiguousarray(cells, dtype=np.int64)
    return dolfinx.mesh.create_mesh(comm, cells, *geometry, **options)


def gmsh_permutation(cell: str, nodes: int) -> Array:
    """p with nodes_dolfinx[i] = nodes_gmsh[p[i]]."""
    return np.asarray(dolfinx.cpp.io.perm_gmsh(getattr(dolfinx.mesh.CellType, cell), nodes))


def num_owned(domain: Any, dim: int = 3) -> int:
    """How many of this rank's entities of this dimension it owns: the first ones."""
    domain.topology.create_entities(dim)
    return int(domain.topology.index_map(dim).size_local)


def input_cells(domain: Any) -> Array:
    """(local cells,) the row of each cell in the input of `create_mesh`."""
    return np.asarray(domain.topology.original_cell_index)


def input_vertices(domain: Any, dim: int) -> Array:
    """(local entities, vertices each) input node numbers of the vertices of each entity."""
    topology = domain.topology
    for d in (dim, 3):
        topology.create_entities(d)
        topology.create_connectivity(d, 0)
    corners = [d + 1 if cell_name(domain) == "tetrahedron" else 2**d for d in range(4)]
    cells = _rows(topology.connectivity(3, 0), corners[3])
    nodes = _geometry_rows(domain)[:, : corners[3]]  # the vertices come first
    index_map = topology.index_map(0)
    number = np.empty(index_map.size_local + index_map.num_ghosts, dtype=np.int64)
    number[cells] = np.asarray(domain.geometry.input_global_indices)[nodes]
    return number[_rows(topology.connectivity(dim, 0), corners[dim])]


def cell_name(domain: Any) -> str:
    """ "tetrahedron" or "hexahedron"."""
    return str(domain.topology.cell_name())


def reference_corners(cell: str) -> Array:
    """(corners, 3) coordinates of the reference cell's vertices."""
    return np.asarray(basix.geometry(getattr(basix.CellType, cell)))


def geometry_dofs(domain: Any) -> Array:
    """(owned cells, nodes per cell) int32: each cell's rows of `geometry_x`."""
    return _geometry_rows(domain)[: num_owned(domain)]


def geometry_x(domain: Any) -> Array:
    """(local nodes, 3) reference coordinates [length] of the geometry's nodes."""
    return np.asarray(domain.geometry.x)


def geometry_degree(domain: Any) -> int:
    """1 or 2."""
    return int(_only(domain.geometry, "cmap").degree)


def _geometry_rows(domain: Any) -> Array:
    nodes = _only(domain.geometry, "cmap").create_dof_layout().num_dofs
    return _rows(_only(domain.geometry, "dofmap"), nodes)


def _only(geometry: Any, name: str) -> Any:
    """geometry.name, of which 0.11 has a list called names: one for each kind of cell."""
    several = getattr(geometry, name + "s", None)
    return several[0] if isinstance(several, list) else getattr(geometry, name)


def coordinates(domain: Any) -> Any:
    """The reference position X as a UFL vector."""
    return ufl.SpatialCoordinate(domain)


def num_exterior_facets(domain: Any) -> int:
    """Facets of this rank's cells on the boundary of the whole mesh."""
    domain.topology.create_connectivity(2, 3)
    return len(dolfinx.mesh.exterior_facet_indices(domain.topology))
