"""Meshes: gmsh sources and .msh files, distributed over the ranks with their physical groups.

gmsh runs on rank 0 only, silently; whatever goes wrong there becomes BadInput on every rank.
Groups are found by the corner nodes of their elements, so they may have any dimension and may
overlap, and each rank finds every entity it knows, ghosts included.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.errors import BadInput, choose, nearest, on_root

DIMENSIONS = ("point", "curve", "surface", "volume")

# gmsh's number of a volume element: our cell, the degree of the geometry, its nodes.
_CELLS = {
    4: ("tetrahedron", 1, 4),
    5: ("hexahedron", 1, 8),
    11: ("tetrahedron", 2, 10),
    12: ("hexahedron", 2, 27),
}


@dataclass(frozen=True)
class Group:
    """A gmsh physical group, as one rank sees it.

    Attributes:
        name: gmsh's name, or the number if it has none.
        dim: 0 point, 1 curve, 2 surface, 3 volume.
        tag: gmsh's number, unique among the groups of this dimension.
        entities: sorted local numbers (int32) of its mesh entities of this dimension that this
            rank knows, ghosts included.
        count: the number of its entities on all ranks, each counted once.
    """

    name: str
    dim: int
    tag: int
    entities: np.ndarray
    count: int

    @property
    def label(self) -> str:
        """Unambiguous, as `Mesh.group` accepts it: ``surface:left``."""
        return f"{DIMENSIONS[self.dim]}:{self.name}"


@dataclass(frozen=True)
class Mesh:
    """A distributed mesh: its dolfinx mesh, the kind of its cells, its physical groups."""

    domain: Any
    cell: str
    groups: tuple[Group, ...]
    num_cells: int

    def group(self, key: str | int) -> Group:
        """The physical group of this name or number, e.g. "left", 3 or "surface:left".

        Raises:
            BadInput: no such group, more than one (then the dimension must be given), or a group
                that has no part in the volume mesh; on every rank.
        """
        found = [g for g in self.groups if str(key) in (g.name, str(g.tag), g.label)]
        found = [g for g in found if str(key) == g.name] or found  # a name beats a number
        if not found:
            known = ", ".join(g.label for g in self.groups) or "none"
            near = nearest(str(key), [g.name for g in self.groups])
            raise BadInput(f"no physical group '{key}' in the mesh{near}: it has {known}")
        if len(found) > 1:
            options = " or ".join(f"'{g.label}'" for g in found)
            raise BadInput(f"physical group '{key}' is ambiguous: write {options}")
        if found[0].count == 0:
            raise BadInput(f"physical group '{key}' has no part in the mesh of the volume")
        return found[0]


class _Physical(NamedTuple):
    """What rank 0 tells every rank about a group.

    `entities` holds input numbers: of cells (dimension 3), or (n, corners) of corner nodes.
    """

    name: str
    dim: int
    tag: int
    entities: np.ndarray


class _Input(NamedTuple):
    """What rank 0 takes from gmsh. Input numbers are rows of `cells` and of `x`."""

    cells: np.ndarray  # (cells, nodes per cell), nodes in dolfinx's order
    x: np.ndarray  # (nodes, 3)
    kind: str
    degree: int
    groups: list[_Physical]


def generate(comm: MPI.Comm, source: str, cell: str, **parameters: float) -> Mesh:
    """Mesh the geometry meshes/<source>.geo. Collective.

    Args:
        source: "cube", "cylinder", ...: the name of a file in meshes/.
        cell: "hexahedron" or "tetrahedron".
        parameters: values for the source's DefineConstant parameters, e.g. cells=15.

    Raises:
        BadInput: unknown source or parameter, or gmsh fails; on every rank.
    """
    choose("cell", cell, sorted({kind for kind, *_ in _CELLS.values()}))
    path = on_root(comm, source_path, source)
    return _distribute(comm, f"geometry '{source}'", _generate, path, cell, parameters)


def read(comm: MPI.Comm, path: str | Path) -> Mesh:
    """Read a gmsh .msh file (format 2.2 or 4.1, ASCII or binary, of order 1 or 2). Collective.

    All its volume cells are taken, whether in a physical group or not.

    Raises:
        BadInput: missing or unreadable, no volume cells, cells of other or of mixed kinds,
            inverted cells; on every rank.
    """
    return _distribute(comm, f"mesh '{path}'", _read, str(path))


def scaled_jacobian(domain: Any) -> np.ndarray:
    """(owned cells,) the worst over each cell's corners and middle; <= 0 where it is inverted.

    At a corner: the volume of the parallelepiped of its three edges over the product of their
    lengths, 1 for a cube and 0.707 for a regular tetrahedron. Left-handed cells are sound, too,
    as long as the sign is the same all over the cell.
    """
    corners = _dolfinx.reference_corners(_dolfinx.cell_name(domain))
    edges = corners - corners[:, None]  # from each corner to each
    nearest_three = np.sort(np.linalg.norm(edges, axis=2).argsort(axis=1)[:, 1:4], axis=1)
    edges = np.take_along_axis(edges, nearest_three[:, :, None], axis=1)
    edges = np.concatenate([edges, np.eye(3)[None]])
    points = np.concatenate([corners, corners.mean(axis=0)[None]])
    gradients = _dolfinx.tabulate_geometry(domain, points)
    x, cells = _dolfinx.geometry_x(domain), _dolfinx.geometry_dofs(domain)
    worst = np.empty(len(cells))
    for start in range(0, len(cells), 10_000):  # in pieces, for the memory
        chunk = slice(start, start + 10_000)
        jacobian = np.einsum("cni,pnj->cpij", x[cells[chunk]], gradients)
        lengths = np.linalg.norm(np.einsum("cpij,pej->cpei", jacobian, edges), axis=3).prod(axis=2)
        scaled = np.linalg.det(jacobian) / np.maximum(lengths, np.finfo(float).tiny)
        worst[chunk] = np.maximum(scaled.min(axis=1), -scaled.max(axis=1))
    return worst


# --- on rank 0: gmsh ---------------------------------------------------------------------------


@contextmanager
def _gmsh() -> Iterator[Any]:
    """The gmsh module, initialised, silent, and finalised whatever happens."""
    handler = signal.getsignal(signal.SIGINT)  # gmsh takes it: 4.8 on import, later on initialize
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise BadInput(f"gmsh's Python module cannot be used: {error}") from None
    gmsh.initialize(readConfigFiles=False)
    try:
        signal.signal(signal.SIGINT, handler)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.onelab.clear()  # parameters outlive finalize
        yield gmsh
    finally:
        gmsh.finalize()
        signal.signal(signal.SIGINT, handler)


def source_path(source: str) -> Path:
    """The file meshes/<source>.geo, in the package or beside it. Raises BadInput if unknown."""
    here = Path(__file__).resolve().parent
    folders = [here / "meshes", here.parent / "meshes"]
    known = {p.stem: p for folder in folders for p in sorted(folder.glob("*.geo"))}
    return known[choose("geometry", source, sorted(known))]


def _generate(path: Path, cell: str, parameters: dict[str, float]) -> _Input:
    with _gmsh() as gmsh:
        gmsh.open(str(path))  # once for the names of the parameters, once with their values
        known = [name for name in gmsh.onelab.getNames() if "/" not in name and name != "tets"]
        gmsh.onelab.setNumber("tets", [float(cell == "tetrahedron")])
        for name, value in parameters.items():
            choose("parameter", name, known)
            if not isfinite(value):
                raise BadInput(f"{name} = {value}: must be a finite number")
            gmsh.onelab.setNumber(name, [float(value)])
        gmsh.clear()
        gmsh.open(str(path))
        gmsh.model.mesh.generate(3)
        return _extract(gmsh)


def _read(path: str) -> _Input:
    # gmsh would take any text for a script of its own and run it.
    with open(path, "rb") as file:
        if file.read(1) != b"$":
            raise BadInput("this is not a gmsh .msh file")
    with _gmsh() as gmsh:
        gmsh.merge(path)
        return _extract(gmsh)


def _extract(gmsh: Any) -> _Input:
    """The volume cells and the physical groups of gmsh's current model."""
    mesh = gmsh.model.mesh
    types, cell_tags, cell_nodes = mesh.getElements(3)
    if not len(types):
        raise BadInput("it has no volume cells: mesh in 3 dimensions, and save all elements")
    if len(types) > 1 or types[0] not in _CELLS:
        names = " and ".join(mesh.getElementProperties(t)[0] for t in types)
        raise BadInput(f"it has cells {names}: all must be tetrahedra, or all hexahedra, order 1-2")
    kind, degree, size = _CELLS[types[0]]
    # Only nodes of cells count (not centres of arcs), and gmsh's numbers may have gaps.
    used, cells = np.unique(np.asarray(cell_nodes[0], dtype=np.int64), return_inverse=True)
    cells = cells.reshape(-1, size)
    # Format 2.2 repeats a cell for each of its physical groups.
    _, first, row = np.unique(np.sort(cells), axis=0, return_index=True, return_inverse=True)
    row_of_tag = dict(zip(cell_tags[0].tolist(), row.ravel().tolist(), strict=True))
    cells = cells[first]

    groups = []
    for dim, tag in gmsh.model.getPhysicalGroups():
        corners = dim + 1 if kind == "tetrahedron" else 2**dim
        parts: list[np.ndarray] = []
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            for kind_number, tags, nodes in zip(*mesh.getElements(dim, entity), strict=True):
                if dim == 3:
                    parts.append(np.array([row_of_tag[t] for t in tags.tolist()], dtype=np.int64))
                    continue
                _, _, _, count, _, primary = mesh.getElementProperties(kind_number)
                if primary == corners:  # other shapes cannot be faces of these cells
                    nodes = np.asarray(nodes, dtype=np.int64).reshape(-1, count)[:, :corners]
                    nodes = nodes[np.isin(nodes, used).all(axis=1)]
                    parts.append(np.searchsorted(used, nodes))
        empty = np.empty(0 if dim == 3 else (0, corners), dtype=np.int64)
        name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
        groups.append(_Physical(name, dim, tag, np.concatenate([empty, *parts])))

    tags, x, _ = mesh.getNodes()
    order = np.argsort(tags)
    x = x.reshape(-1, 3)[order[np.searchsorted(tags, used, sorter=order)]]
    cells = cells[:, _dolfinx.gmsh_permutation(kind, size)]
    return _Input(cells, x, kind, degree, groups)


# --- on every rank -----------------------------------------------------------------------------


def _distribute(comm: MPI.Comm, what: str, make: Callable[..., _Input], *args: Any) -> Mesh:
    """Call make(*args) on rank 0, distribute its cells, and find its groups on every rank."""
    kept: list[_Input] = []

    def on_rank_0() -> tuple[_Input, int]:
        try:
            made = make(*args)
        except OSError as error:
            raise BadInput(f"{what} cannot be read: {error.strerror or error}") from None
        except BadInput as error:
            raise BadInput(f"{what}: {error}") from None
        except Exception as error:  # gmsh raises nothing more special, and no rank may wait
            who = "gmsh" if type(error) is Exception else type(error).__name__
            raise BadInput(f"{what}: {who}: {' '.join(str(error).split())}") from None
        kept.append(made)
        return made._replace(cells=made.cells[:0], x=made.x[:0]), len(made.cells)

    common, num_cells = on_root(comm, on_rank_0)  # all ranks get the groups, none the cells
    mine = kept[0] if kept else common
    domain = _dolfinx.create_mesh(comm, mine.cells, mine.x, common.kind, common.degree)
    bad = comm.allreduce(int((scaled_jacobian(domain) < 1e-10).sum()))
    if bad:
        raise BadInput(f"{what} has {bad} inverted or degenerate cells of {num_cells}")
    groups = tuple(_locate(domain, group) for group in common.groups)
    return Mesh(domain, common.kind, groups, num_cells)


def _locate(domain: Any, group: _Physical) -> Group:
    """Find the group's entities among those this rank knows. Collective."""
    if group.dim == 3:
        local = np.isin(_dolfinx.input_cells(domain), group.entities)
    else:
        local = _rows_in(_dolfinx.input_vertices(domain, group.dim), group.entities)
    owned = _dolfinx.num_owned(domain, group.dim)
    count = domain.comm.allreduce(int(local[:owned].sum()))
    entities = np.flatnonzero(local).astype(np.int32)
    return Group(group.name, group.dim, group.tag, entities, count)


def _rows_in(rows: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Which of the rows (n, k) hold the same numbers, in any order, as some row of wanted."""
    found = np.isin(rows, wanted).all(axis=1)  # few are left to compare as a whole
    both = np.sort(np.concatenate([wanted, rows[found]]), axis=1)
    label = np.unique(both, axis=0, return_inverse=True)[1].ravel()
    found[found] = np.isin(label[len(wanted) :], label[: len(wanted)])
    return found
