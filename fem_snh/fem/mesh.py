"""Meshes: gmsh sources and .msh files, distributed over the ranks with their physical groups.

gmsh runs on rank 0 only, silently; whatever goes wrong there becomes BadInput on every rank.
Groups are found by the corner nodes of their elements, so they may have any dimension and may
overlap, and each rank finds every entity it knows, ghosts included.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.errors import BadInput, choose, nearest, on_root
from fem_snh.fem import gmsh_input

DIMENSIONS = ("point", "curve", "surface", "volume")


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


def generate(comm: MPI.Comm, source: str, cell: str, **parameters: float) -> Mesh:
    """Mesh the geometry meshes/<source>.geo. Collective.

    Args:
        source: "cube", "cylinder", ...: the name of a file in meshes/.
        cell: "hexahedron" or "tetrahedron".
        parameters: values for the source's DefineConstant parameters, e.g. cells=15.

    Raises:
        BadInput: unknown source or parameter, or gmsh fails; on every rank.
    """
    choose("cell", cell, gmsh_input.KINDS)
    path = on_root(comm, gmsh_input.source_path, source)
    return _distribute(comm, f"geometry '{source}'", gmsh_input.generate, path, cell, parameters)


def read(comm: MPI.Comm, path: str | Path) -> Mesh:
    """Read a gmsh .msh file (format 2.2 or 4.1, ASCII or binary, of order 1 or 2). Collective.

    All its volume cells are taken, whether in a physical group or not.

    Raises:
        BadInput: missing or unreadable, no volume cells, cells of other or of mixed kinds,
            inverted cells; on every rank.
    """
    return _distribute(comm, f"mesh '{path}'", gmsh_input.read, str(path))


def volume(domain: Any) -> float:
    """The volume of a dolfinx mesh [m^3]. Collective."""
    points, weights = _dolfinx.quadrature(_dolfinx.cell_name(domain), 5)
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)]
    T = np.einsum("cai,qak->cqik", x, _dolfinx.tabulate_geometry(domain, points))
    return float(domain.comm.allreduce((np.abs(np.linalg.det(T)) * weights).sum()))


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


# --- on every rank -----------------------------------------------------------------------------


def _distribute(
    comm: MPI.Comm, what: str, make: Callable[..., gmsh_input.Input], *args: Any
) -> Mesh:
    """Call make(*args) on rank 0, distribute its cells, and find its groups on every rank."""
    kept: list[gmsh_input.Input] = []

    def on_rank_0() -> tuple[gmsh_input.Input, int]:
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


def _locate(domain: Any, group: gmsh_input.Physical) -> Group:
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
    found: np.ndarray = np.all(np.isin(rows, wanted), axis=1)  # few are left to compare as a whole
    both = np.sort(np.concatenate([wanted, rows[found]]), axis=1)
    label = np.unique(both, axis=0, return_inverse=True)[1].ravel()
    found[found] = np.isin(label[len(wanted) :], label[: len(wanted)])
    return found
