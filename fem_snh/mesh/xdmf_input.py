"""Meshes in XDMF files: every rank reads its part of cells, nodes and groups, and none reads all.

The text of the file lists grids; the numbers are in HDF5 files. One grid is the mesh. Each grid
with an attribute of cells has tags of entities (dolfinx's meshtags). Entities with equal tags are a
group, which an ``Information`` names: ``Name="surface:3"``, ``Value="left"``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.errors import BadInput, on_every, on_root
from fem_snh.files import xdmf_data, xdmf_root
from fem_snh.mesh.gmsh_model import FLAT, PhysicalGroup
from fem_snh.mesh.mesh_checks import largest

if TYPE_CHECKING:
    from xml.etree import ElementTree as ET

#: Dimension of the entities of a grid by XDMF's types of topology; a suffix of a type, as in
#: Triangle_6, is the number of nodes.
_DIMENSIONS = {
    "polyvertex": 0, "polyline": 1, "edge": 1, "triangle": 2, "quadrilateral": 2, "tetrahedron": 3,
    "hexahedron": 3,
}  # fmt: skip


class Grids(NamedTuple):
    """The grids of a file.

    Attributes
    ----------
    mesh : str
        Name of the mesh's grid: the first grid of the highest dimension.
    dim : int
        Dimension of the mesh's cells.
    tags : tuple of (str, int)
        Name of each grid with tags, and dimension of the tagged entities.
    names : dict
        Names of groups by (dimension, tag).
    """

    mesh: str
    dim: int
    tags: tuple[tuple[str, int], ...]
    names: dict[tuple[int, int], str]


def read(
    comm: MPI.Intracomm, path: Path, dimensions: tuple[str, ...]
) -> tuple[Any, list[PhysicalGroup]]:
    """Return the dolfinx mesh of a file, and its groups with local entities. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The ranks.
    path : Path
        The .xdmf file.
    dimensions : tuple of str
        Names of the dimensions 0, 1, 2 and 3.

    Raises
    ------
    BadInput
        On every rank, if the file cannot be read.
    """
    grids = on_root(comm, _read_grids, path, dimensions)

    def read_grid(grid: str, function: Callable[..., Any], *args: Any) -> Any:
        try:
            return function(*args)
        except RuntimeError as error:
            raise BadInput(f"grid '{grid}': {error}") from None

    mesh = grids.mesh
    cells, x, cell, degree = on_every(comm, read_grid, mesh, _dolfinx.read_xdmf, comm, path, mesh)
    num_nodes = comm.allreduce(len(x))
    _check_nodes(comm, mesh, cells, num_nodes)
    if x.shape[1] > grids.dim:
        if largest(comm, x[:, 2]) > FLAT * largest(comm, x):
            raise BadInput(f"it has cells {cell}: expected volumes, or nodes in the plane z = 0")
        x = x[:, : grids.dim]
    domain = _dolfinx.create_mesh(comm, cells, x, cell, degree)
    groups: dict[tuple[int, int], PhysicalGroup] = {}
    for grid, dim in grids.tags:
        nodes = on_every(comm, read_grid, grid, _dolfinx.read_xdmf_nodes, comm, path, grid)
        _check_nodes(comm, grid, nodes, num_nodes)
        arguments = grid, _dolfinx.read_xdmf_tags, domain, path, grid, dim
        entities, values = on_every(comm, read_grid, *arguments)
        found = comm.allgather(np.unique(values))
        for tag in np.unique(np.concatenate(found)).tolist():
            if (dim, tag) in groups:
                raise BadInput(
                    f"grid '{grid}' = {dimensions[dim]} {tag}: expected each number in one grid "
                    "of a dimension"
                )
            name = grids.names.get((dim, tag), str(tag))
            chosen = np.sort(entities[values == tag]).astype(np.int32)
            groups[dim, tag] = PhysicalGroup(name, dim, tag, chosen)
    return domain, list(groups.values())


def _check_nodes(comm: MPI.Intracomm, grid: str, nodes: Array, count: int) -> None:
    """Raise BadInput on every rank for node numbers outside of 0 to count - 1. Collective.

    With these, dolfinx searches for the node's owner for ever, or reads beyond its arrays.
    """
    bad = nodes[(nodes < 0) | (nodes >= count)].tolist()
    found = [number for part in comm.allgather(bad[:1]) for number in part]
    if found:
        raise BadInput(
            f"grid '{grid}': node {found[0]}: expected numbers from 0 to {count - 1} of its nodes"
        )


def _read_grids(path: Path, dimensions: tuple[str, ...]) -> Grids:
    """Return the grids of a file. Raises BadInput and OSError."""
    try:
        root = xdmf_root(path)
    except ValueError as error:
        raise BadInput(f"this is not an XDMF file: {error}") from None
    for file in xdmf_data(path):
        file.open("rb").close()
    every = root.findall("./Domain/Grid")
    grids = [(dim, grid) for grid in every if (dim := _dimension(grid)) >= 0]
    highest = max((dim for dim, _ in grids), default=0)
    if highest < 2:
        raise BadInput("it has no grid of cells: expected tetrahedra, hexahedra, or cells in 2D")
    mesh = next(grid for dim, grid in grids if dim == highest)
    tags = [
        (grid.get("Name") or "", dim)
        for dim, grid in grids
        if any(of.get("Center") == "Cell" for of in grid.findall("Attribute"))
    ]
    names = {}
    for note in root.findall("./Domain/Information"):
        word, _, tag = (note.get("Name") or "").partition(":")
        if word in dimensions and re.fullmatch(r"-?[0-9]{1,18}", tag):
            names[dimensions.index(word), int(tag)] = note.get("Value") or tag
    return Grids(mesh.get("Name") or "", highest, tuple(tags), names)


def _dimension(grid: ET.Element) -> int:
    """Return the dimension of a grid's entities, -1 for an unknown type."""
    topology = grid.find("Topology")
    kind = "" if topology is None else (topology.get("TopologyType") or "")
    return _DIMENSIONS.get(kind.lower().partition("_")[0], -1)
