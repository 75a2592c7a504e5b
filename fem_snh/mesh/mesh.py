"""Meshes from gmsh sources, .msh and .xdmf files, distributed over the ranks with their groups.

gmsh runs on rank 0 only; its errors become BadInput on every rank. Groups are located by the corner
nodes of their elements, so they may have any dimension and may overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.choices import DEFAULT_CELLS
from fem_snh.errors import BadInput, choose, on_every, on_root, suggestion_for
from fem_snh.files import is_shape
from fem_snh.mesh import gmsh_input
from fem_snh.mesh.gmsh_model import CELL_KINDS, MeshData, NodeCopies, PhysicalGroup, Skin
from fem_snh.mesh.mesh_checks import check_geometry

if TYPE_CHECKING:
    from fem_snh.mesh.round_faces import RoundFaces

#: Suffix of mesh files of which every rank reads a part.
XDMF = ".xdmf"
#: Names of the dimensions 0 to 3 in `Group.label`.
DIMENSIONS = ("point", "curve", "surface", "volume")
#: Quadrature degree that integrates det(dx/dxi) exactly on cells of geometric degree 1 and 2.
_VOLUME_DEGREE = 5
#: Quadrature degree of a centroid: exact on affine cells and on parallelograms.
_DEGREE = 4


@dataclass(frozen=True)
class Group:
    """A gmsh physical group on one rank.

    Attributes
    ----------
    name : str
        gmsh's name, or the number if it has none.
    dim : int
        0 point, 1 curve, 2 surface, 3 volume.
    tag : int
        gmsh's number, unique among the groups of this dimension.
    entities : (n,) int32
        Sorted local numbers of the group's mesh entities on this rank, ghosts included.
    count : int
        Number of the group's entities on all ranks, each counted once.
    """

    name: str
    dim: int
    tag: int
    entities: np.ndarray
    count: int

    @property
    def label(self) -> str:
        """Dimension and name, e.g. ``surface:left``; `Mesh.group` accepts it."""
        return f"{DIMENSIONS[self.dim]}:{self.name}"


@dataclass(frozen=True)
class Mesh:
    """A distributed mesh with its physical groups.

    Attributes
    ----------
    domain : dolfinx Mesh
    cell : {"hexahedron", "tetrahedron", "quadrilateral", "triangle"}
    groups : tuple of Group
    num_cells : int
        Number of cells on all ranks.
    fractions : (local cells,) array or None
        For a lattice, the fraction of each cell that the body fills, ghosts included; None: 1.
    skin : Skin or None
        For a lattice, the surface of the body, which moves with the cells.
    copies : NodeCopies or None
        For a lattice, the nodes that are copies.
    round_faces : RoundFaces or None
        For a bisected mesh, the result of `fem_snh.mesh.round_faces` for the original mesh, as the
        smaller facets no longer show round faces.
    """

    domain: _dolfinx.Mesh
    cell: str
    groups: tuple[Group, ...]
    num_cells: int
    fractions: np.ndarray | None = None
    skin: Skin | None = None
    copies: NodeCopies | None = None
    round_faces: RoundFaces | None = None

    @property
    def dim(self) -> int:
        """Dimension of the cells, 2 or 3."""
        return _dolfinx.mesh_dimension(self.domain)[0]

    @property
    def has_parts(self) -> bool:
        """Whether a physical group has some, but not all, of the cells."""
        return any(g.dim == self.dim and 0 < g.count < self.num_cells for g in self.groups)

    def group(self, key: str | int) -> Group:
        """Return the physical group with this name, number or label.

        Parameters
        ----------
        key : str or int
            For example "left", 3 or "surface:left". A name takes precedence over a number.

        Raises
        ------
        BadInput
            On every rank: no such group, several (the label then distinguishes them), or a group
            without entities in the volume mesh.
        """
        found = [g for g in self.groups if str(key) in (g.name, str(g.tag), g.label)]
        found = [g for g in found if str(key) == g.name] or found
        if not found:
            known = ", ".join(g.label for g in self.groups) or "none"
            suggestion = suggestion_for(str(key), [g.name for g in self.groups])
            raise BadInput(f"no physical group '{key}' in the mesh{suggestion}: it has {known}")
        if len(found) > 1:
            options = " or ".join(f"'{g.label}'" for g in found)
            raise BadInput(f"physical group '{key}' is ambiguous: write {options}")
        if found[0].count == 0:
            raise BadInput(f"physical group '{key}' has no part in the mesh of the volume")
        return found[0]


def generate(comm: MPI.Comm, source: str, cell: str, **parameters: float) -> Mesh:
    """Mesh a geometry of the meshes folder. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator over which the mesh is distributed.
    source : str
        Name of a file meshes/<source>.geo, e.g. "cube".
    cell : {"hexahedron", "tetrahedron"}
        Kind of cell.
    **parameters : float
        Values of the source's DefineConstant parameters, e.g. cells=15.

    Raises
    ------
    BadInput
        On every rank, for an unknown source or parameter, or if gmsh fails.
    """
    choose("cell", cell, CELL_KINDS)
    path = on_root(comm, gmsh_input.source_path, source)
    return distribute(comm, f"geometry '{source}'", gmsh_input.generate, path, cell, parameters)


def read(comm: MPI.Comm, path: str | Path, cells: int = DEFAULT_CELLS) -> Mesh:
    """Read a gmsh .msh file: format 2.2 or 4.1, ASCII or binary, order 1 or 2. Collective.

    Every rank reads its part of an .xdmf file (`fem_snh.mesh.xdmf_input`). The shape of an .xao
    file is meshed with ``cells`` simplices along its longest extent, and at least 12 around a
    circle.

    The cells are those of the highest dimension: volumes, or surfaces in the plane z = 0. All
    cells belong to the mesh, whether in a physical group or not.

    Raises
    ------
    BadInput
        On every rank, if the file cannot be read, or has no cells, cells of another kind or
        of several kinds, or a geometry that `check_geometry` refuses.
    """
    if is_shape(Path(path)):
        return distribute(comm, f"mesh '{path}'", gmsh_input.mesh_shape, str(path), cells)
    if Path(path).suffix.lower() != XDMF:
        return distribute(comm, f"mesh '{path}'", gmsh_input.read, str(path))
    from fem_snh.mesh import xdmf_input

    try:
        domain, found = xdmf_input.read(comm, Path(path), DIMENSIONS)
    except BadInput as error:
        raise BadInput(f"mesh '{path}': {error}") from None
    check_geometry(domain, f"mesh '{path}'")
    cell, num_cells = _dolfinx.cell_name(domain), _dolfinx.num_cells(domain)
    groups = tuple(_group(domain, *group) for group in found)
    return Mesh(domain, cell, groups, num_cells)


def write_xdmf(mesh: Mesh, path: str | Path) -> None:
    """Write a mesh and its groups as an XDMF file with an .h5 file beside it. Collective.

    Raises
    ------
    BadInput
        On every rank, if the file cannot be written.
    """
    groups = [group for group in mesh.groups if group.count]
    tags = [
        (f"{DIMENSIONS[group.dim]}_{group.tag}", group.dim, group.entities, group.tag)
        for group in groups
    ]
    names = {f"{DIMENSIONS[group.dim]}:{group.tag}": group.name for group in groups}

    def write() -> None:
        try:
            _dolfinx.write_xdmf(mesh.domain, Path(path), tags, names)
        except RuntimeError as error:
            raise BadInput(f"cannot write {path}: {error}") from None

    on_every(mesh.domain.comm, write)


def volume(domain: _dolfinx.Mesh, revolved: bool = False) -> float:
    """Return the volume of a dolfinx mesh [m^3], in two dimensions its area. Collective.

    With ``revolved`` it is the volume of the mesh revolved about the axis x = 0.
    """
    return float(domain.comm.allreduce(point_volumes(domain, revolved=revolved).sum()))


def cell_volumes(domain: _dolfinx.Mesh, revolved: bool = False) -> np.ndarray:
    """Return the volume of each cell [m^3], (owned cells,); see `volume`."""
    return point_volumes(domain, revolved=revolved).sum(axis=1)


def point_volumes(
    domain: _dolfinx.Mesh, degree: int = _VOLUME_DEGREE, revolved: bool = False
) -> np.ndarray:
    """Return quadrature weights times det(dx/dxi) [m^3], (owned cells, points); see `volume`."""
    points, weights = _dolfinx.quadrature(_dolfinx.cell_name(domain), degree)
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)]
    x = x[..., : points.shape[1]]
    gradients = _dolfinx.tabulate_geometry(domain, points)
    T = np.einsum("cai,qak->cqik", x, gradients, optimize=True)
    products: np.ndarray = np.abs(np.linalg.det(T)) * weights
    if revolved:
        products *= 2 * np.pi * (x[..., 0] @ _dolfinx.tabulate_geometry_values(domain, points).T)
    return products


def distribute(comm: MPI.Comm, what: str, make: Callable[..., MeshData], *args: Any) -> Mesh:
    """Distribute the mesh that ``make(*args)`` returns on rank 0, with its groups. Collective.

    Errors become BadInput on every rank, with the name ``what`` in the message.
    """
    kept: list[MeshData] = []

    def make_on_root() -> tuple[MeshData, int]:
        try:
            data = make(*args)
        except OSError as error:
            raise BadInput(f"{what} cannot be read: {error.strerror or error}") from None
        except BadInput as error:
            raise BadInput(f"{what}: {error}") from None
        except Exception as error:  # gmsh raises bare Exception; the other ranks wait for a result
            who = "gmsh" if type(error) is Exception else type(error).__name__
            reason = " ".join(str(error).split()) or "failed without a reason, as without memory"
            raise BadInput(f"{what}: {who}: {reason}") from None
        kept.append(data)
        return data._replace(cells=data.cells[:0], x=data.x[:0]), len(data.cells)

    common, num_cells = on_root(comm, make_on_root)
    data = kept[0] if kept else common  # all ranks get the groups, only rank 0 the cells
    try:
        domain = _dolfinx.create_mesh(comm, data.cells, data.x, common.cell, common.degree)
    except RuntimeError as error:
        if common.skin is None:
            raise
        # dolfinx counts a cell twice that shares two faces with another cell. Other ranks may go
        # on: an exception that not all ranks raise must end the program.
        raise (BadInput if comm.size == 1 else RuntimeError)(
            f"{what}: dolfinx cannot number these {num_cells:,} cells "
            f"({str(error).rstrip('.')}): expected another size of cells"
        ) from None
    check_geometry(domain, what, may_overlap=common.skin is not None)
    # Entities and their vertices are the same for all groups of a dimension.
    vertices = cache(partial(_dolfinx.input_vertices, domain))
    groups = tuple(_locate(domain, group, vertices) for group in common.groups)
    fractions = common.fractions
    fractions = None if fractions is None else fractions[_dolfinx.input_cells(domain)]
    return Mesh(domain, common.cell, groups, num_cells, fractions, common.skin, common.copies)


def _locate(domain: _dolfinx.Mesh, group: PhysicalGroup, vertices: Callable[[int], Array]) -> Group:
    """Return the group with its entities on this rank. Collective.

    ``vertices`` returns the input node numbers of the vertices of all entities of a dimension.
    """
    if group.dim == _dolfinx.mesh_dimension(domain)[0]:
        local = np.isin(_dolfinx.input_cells(domain), group.entities)
    else:
        local = _rows_in(vertices(group.dim), group.entities)
    entities = np.flatnonzero(local).astype(np.int32)
    return _group(domain, group.name, group.dim, group.tag, entities)


def _group(domain: _dolfinx.Mesh, name: str, dim: int, tag: int, entities: np.ndarray) -> Group:
    """Return the group with these local entities. Collective."""
    owned = _dolfinx.num_owned(domain, dim)
    count = domain.comm.allreduce(int((entities < owned).sum()))
    return Group(name, dim, tag, entities, count)


def _rows_in(rows: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return which rows (n, k) hold the numbers of a row of ``wanted``, in any order, (n,)."""
    found: np.ndarray = np.all(np.isin(rows, wanted), axis=1)  # only few rows remain to compare
    both = np.sort(np.concatenate([wanted, rows[found]]), axis=1)
    label = np.unique(both, axis=0, return_inverse=True)[1].ravel()
    found[found] = np.isin(label[len(wanted) :], label[: len(wanted)])
    return found


def gather(mesh: Mesh) -> MeshData:
    """Return a distributed mesh on rank 0, with its original numbering. Collective.

    On other ranks the result has this rank's cells, no coordinates and empty groups.
    """
    domain, comm = mesh.domain, mesh.domain.comm
    owned = _dolfinx.num_owned(domain)
    nodes, rows = _dolfinx.input_nodes(domain), _dolfinx.input_cells(domain)
    cells = nodes[_dolfinx.geometry_dofs(domain)]
    parts = comm.gather((rows[:owned], cells, nodes, _dolfinx.geometry_x(domain)))
    groups = []
    for group in mesh.groups:
        local = group.entities
        if group.dim == mesh.dim:
            entities = rows[local[local < owned]]
        else:
            entities = _dolfinx.input_vertices(domain, group.dim)[local]
        pieces = comm.gather(entities)
        found = np.unique(np.concatenate(pieces), axis=0) if pieces else entities[:0]
        groups.append(PhysicalGroup(group.name, group.dim, group.tag, found))
    degree = _dolfinx.geometry_degree(domain)
    x = np.empty((0, mesh.dim))
    if parts:
        cells = np.empty((sum(len(part[0]) for part in parts), cells.shape[1]), dtype=np.int64)
        x = np.zeros((max(int(part[2].max(initial=-1)) for part in parts) + 1, mesh.dim))
        for cell_rows, cell_nodes, node_rows, coordinates in parts:
            cells[cell_rows], x[node_rows] = cell_nodes, coordinates[:, : mesh.dim]
    return MeshData(cells, x, mesh.cell, degree, groups)


def of_input_cells(domain: _dolfinx.Mesh, values: Array) -> Array:
    """Return values (owned cells, ...) on rank 0 in the order of `gather`. Collective.

    On other ranks the result has this rank's cells.
    """
    rows = _dolfinx.input_cells(domain)[: len(values)]
    parts = domain.comm.gather((rows, values)) or [(rows, values)]
    numbers, gathered = map(np.concatenate, zip(*parts, strict=True))
    return np.asarray(gathered[np.argsort(numbers)])


def centroid(domain: _dolfinx.Mesh, dim: int, entities: Array) -> Array:
    """Return the reference centroid (3,) [m] of cells or facets; NaN without any. Collective.

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh.
    dim : int
        The dimension of the entities: the cells' or one less.
    entities : (n,) int
        Local entities of this rank, ghosts included.
    """
    cell = _dolfinx.cell_name(domain)
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)][..., : domain.topology.dim]
    shares, kind = np.isin(np.arange(_dolfinx.num_owned(domain)), entities)[:, None] * 1.0, cell
    origins, tangents = np.zeros((1, x.shape[2])), np.eye(x.shape[2])[None]
    if dim < domain.topology.dim:
        kind, facets = _dolfinx.FACET_OF[cell], _dolfinx.cell_facets(domain)
        exterior = np.isin(facets, _dolfinx.exterior_facets(domain)[0])
        shares = np.isin(facets, entities) * np.where(exterior, 1.0, 0.5)  # of two cells
        origins, tangents = _dolfinx.facet_maps(cell)
    points, weights = _dolfinx.quadrature(kind, _DEGREE)
    sums = np.zeros(4)
    for share, origin, tangent in zip(shares.T, origins, tangents, strict=True):
        nodes = x[: len(share)][share > 0]
        at = origin + points @ tangent
        T = np.einsum("cai,qak->cqik", nodes, _dolfinx.tabulate_geometry(domain, at)) @ tangent.T
        sizes = np.sqrt(np.linalg.det(np.swapaxes(T, 2, 3) @ T)) * weights
        sizes *= share[share > 0][:, None]
        places = np.einsum("cai,qa->cqi", nodes, _dolfinx.tabulate_geometry_values(domain, at))
        sums[3] += sizes.sum()
        sums[: x.shape[2]] += np.einsum("cq,cqi->i", sizes, places)
    sums = domain.comm.allreduce(sums)
    return np.asarray(sums[:3] / sums[3])
