"""The only module that knows which dolfinx it runs on (0.5, 0.9 and 0.11 are tried).

Features are detected, versions are not compared. Small functions with one signature for all
versions; everything else in the project takes version-dependent names from here alone.

Local numbering, as in dolfinx: the entities and nodes a rank owns come first, ghosts after them.
Meshes made by `create_mesh` have no ghost cells, so each rank's cells are the ones it owns.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from inspect import signature
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from mpi4py import MPI
from petsc4py import PETSc

import basix
import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.io import VTKFile

version: str = dolfinx.__version__

Array = np.ndarray


@contextmanager
def _quiet() -> Iterator[None]:
    """The compiler's chatter (INFO records of the root logger, 0.5 under Debian 12) unheard."""
    before = logging.root.manager.disable
    logging.disable(max(before, logging.INFO))
    try:
        yield
    finally:
        logging.disable(before)


def _rows(table: Any, width: int) -> Array:
    """A dofmap or connectivity as a (rows, width) array, also if this rank has no rows.

    Connectivities are adjacency lists, as dofmaps were in 0.5 (arrays since 0.7).
    """
    return np.asarray(getattr(table, "array", table)).reshape(-1, width)


# --- meshes ------------------------------------------------------------------------------------


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


# --- spaces and elements -----------------------------------------------------------------------


def function_space(
    domain: Any, degree: int, shape: tuple[int, ...] = (), family: str = "Lagrange"
) -> Any:
    """A scalar (shape ()) or vector (shape (3,)) space; family "Lagrange" or "DG"."""
    with _quiet():
        if hasattr(fem, "functionspace"):  # since 0.7
            return fem.functionspace(domain, (family, degree, shape) if shape else (family, degree))
        if shape:
            return fem.VectorFunctionSpace(domain, (family, degree), dim=shape[0])
        return fem.FunctionSpace(domain, (family, degree))


def function(V: Any, name: str) -> Any:
    """A zero function on V; output files call it by its name."""
    u = fem.Function(V)
    u.name = name
    return u


def surface_measure(domain: Any, facets: Array) -> Any:
    """The UFL measure of the exterior facets among these local ones."""
    facets = np.unique(facets).astype(np.int32)
    tags = dolfinx.mesh.meshtags(domain, 2, facets, np.ones(len(facets), np.int32))
    return ufl.Measure("ds", domain=domain, subdomain_data=tags)(1)


def degree(V: Any) -> int:
    """The polynomial degree of V's element."""
    element = V.ufl_element()
    return int(element.degree if isinstance(element.degree, int) else element.degree())


def node_dofs(V: Any) -> Array:
    """(owned cells, nodes per cell) int32: the local nodes (blocks of V's dofs) of each cell."""
    return _rows(V.dofmap.list, V.dofmap.dof_layout.num_dofs)[: num_owned(V.mesh)]


def num_nodes(V: Any) -> tuple[int, int]:
    """(owned, ghost) nodes of V on this rank; a local vector has bs times their sum entries."""
    index_map = V.dofmap.index_map
    return int(index_map.size_local), int(index_map.num_ghosts)


def local_to_global(V: Any) -> Array:
    """(owned + ghost nodes,) int64: global number of each local node."""
    index_map = V.dofmap.index_map
    first = index_map.local_range[0]
    owned = np.arange(first, first + index_map.size_local, dtype=np.int64)
    return np.concatenate([owned, np.asarray(index_map.ghosts, dtype=np.int64)])


def _gradients(cell: str, degree: int, points: Array) -> Array:
    family = basix.ElementFamily.P
    element = basix.create_element(
        family, getattr(basix.CellType, cell), degree, basix.LagrangeVariant.gll_warped
    )
    table = element.tabulate(1, np.ascontiguousarray(points, dtype=np.float64))
    return np.ascontiguousarray(np.moveaxis(table[1:4, :, :, 0], 0, -1))


def tabulate(V: Any, points: Array) -> Array:
    """(points, nodes, 3) derivatives, in reference coordinates, of V's scalar basis functions.

    Nodes are in the order of `node_dofs` (for degree 1 and 2 no cell permutes them).
    """
    return _gradients(cell_name(V.mesh), degree(V), points)


def tabulate_geometry(domain: Any, points: Array) -> Array:
    """(points, nodes, 3) derivatives of the geometry's basis, in the order of `geometry_dofs`."""
    return _gradients(cell_name(domain), geometry_degree(domain), points)


def quadrature(cell: str, degree: int) -> tuple[Array, Array]:
    """(points (n, 3), weights (n,)) exact for polynomials of this degree on the reference cell."""
    points, weights = basix.make_quadrature(getattr(basix.CellType, cell), degree)
    return points, weights


def locate_dofs(V: Any, dim: int, entities: Array) -> Array:
    """Local nodes of V (int32, ghosts included) on the entities' closure. Collective."""
    V.mesh.topology.create_connectivity(dim, 3)
    return np.asarray(fem.locate_dofs_topological(V, dim, np.asarray(entities, np.int32)))


# --- vectors, forms, assembly ------------------------------------------------------------------


def petsc_vec(u: Any) -> PETSc.Vec:
    """The ghosted PETSc vector that shares u's memory."""
    return u.x.petsc_vec if hasattr(u.x, "petsc_vec") else u.vector


def create_vector(V: Any) -> PETSc.Vec:
    """A new ghosted vector on V, with V's block size."""
    index_map, bs = V.dofmap.index_map, V.dofmap.index_map_bs
    size = (index_map.size_local * bs, index_map.size_global * bs)
    ghosts = np.asarray(index_map.ghosts, dtype=PETSc.IntType)
    vector = PETSc.Vec().createGhost(ghosts, size, bsize=bs, comm=V.mesh.comm)
    vector.set(0.0)
    return vector


def _jit(function: Any, options: dict | None) -> dict:
    """JIT options under the name that this version of `function` knows (params in 0.5)."""
    if not options:
        return {}
    name = "jit_options" if "jit_options" in signature(function).parameters else "jit_params"
    return {name: options}


def form(ufl_form: Any, jit_options: dict | None = None) -> Any:
    """Compile a UFL form, e.g. with {"cffi_extra_compile_args": ["-O3", "-march=native"]}."""
    with _quiet():
        return fem.form(ufl_form, **_jit(fem.form, jit_options))


def interpolate(u: Any, expression: Any, jit_options: dict | None = None) -> None:
    """Put a UFL expression into the function u, at its element's interpolation points."""
    points = u.function_space.element.interpolation_points
    points = points() if callable(points) else points  # a method up to 0.9
    with _quiet():
        options = _jit(fem.Expression.__init__, jit_options)
        u.interpolate(fem.Expression(expression, points, **options))
    u.x.scatter_forward()


def assemble_scalar(compiled: Any) -> float:
    """The integral over all ranks. Collective."""
    domain = compiled.mesh
    return float(domain.comm.allreduce(fem.assemble_scalar(compiled), op=MPI.SUM))


def assemble_vector(vector: PETSc.Vec, compiled: Any) -> None:
    """Overwrite a ghosted vector by a linear form, summed over the ranks; ghosts are updated."""
    with vector.localForm() as local:
        local.set(0.0)
    fem_petsc.assemble_vector(vector, compiled)
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)


def create_matrix(compiled: Any) -> PETSc.Mat:
    """An AIJ matrix (V's block size) with the pattern of a bilinear form."""
    return fem_petsc.create_matrix(compiled)


def assemble_matrix(matrix: PETSc.Mat, compiled: Any, bcs: Sequence[Any] = ()) -> None:
    """Overwrite a matrix by a bilinear form; rows and columns of bcs are 1 on the diagonal."""
    matrix.zeroEntries()
    assemble: Any = getattr(fem_petsc, "assemble_matrix_mat", fem_petsc.assemble_matrix)
    assemble(matrix, compiled, list(bcs))
    matrix.assemble()


# --- output ------------------------------------------------------------------------------------


class Writer:
    """Writes functions of one mesh at increasing times; see `vtk_writer`."""

    def __init__(self, file: Any, comm: MPI.Comm, path: Path) -> None:
        self._file, self._comm, self._path = file, comm, path

    def write(self, functions: Sequence[Any], t: float) -> None:
        """Write functions (Lagrange ones of one degree first, then DG0) at time t. Collective.

        The file can be read from then on, whatever becomes of the process.
        """
        self._file.write_function(list(functions), t)
        self._file.close()  # writes the .pvd, which nothing else does; more can be written after
        if self._comm.rank == 0:
            latest = ET.parse(self._path).findall(".//DataSet")[-1].attrib["file"]
            _drop_repeated_pieces(self._path.parent / latest)


def _drop_repeated_pieces(path: Path) -> None:
    """0.5 lists each piece once a function: readers then see every cell as often."""
    tree = ET.parse(path)
    for grid in tree.getroot():
        seen: set[str] = set()
        for piece in grid.findall("Piece"):
            source = piece.attrib["Source"]
            if source in seen:
                grid.remove(piece)
            seen.add(source)
    tree.write(path)


@contextmanager
def vtk_writer(comm: MPI.Comm, path: str | Path) -> Iterator[Writer]:
    """A .pvd (with .vtu/.pvtu pieces beside it) open for writing. Collective."""
    with VTKFile(comm, str(path), "w") as file:
        yield Writer(file, comm, Path(path))
