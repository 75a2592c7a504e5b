"""Meshes in XDMF files: every rank reads its part of cells, nodes and groups, and none reads all.

The text of the file lists grids; the numbers are in HDF5 files. A grid is the mesh; each grid with
an attribute of cells has tags of some entities (dolfinx's meshtags). Tags of equal value are a
group, which an ``Information`` names: ``Name="surface:3"``, ``Value="left"``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.errors import BadInput, bad_value, on_every, on_root
from fem_snh.files import xdmf_data, xdmf_root
from fem_snh.mesh.gmsh_model import FLAT, PhysicalGroup
from fem_snh.mesh.mesh_checks import largest

if TYPE_CHECKING:
    from xml.etree import ElementTree as ET

Array = npt.NDArray[Any]

#: Dimension and vertices of the entities of a grid by XDMF's types of topology. A suffix of a type,
#: as in Triangle_6, is the number of nodes.
_KINDS = {
    "polyvertex": (0, 1), "polyline": (1, 2), "edge": (1, 2), "triangle": (2, 3),
    "quadrilateral": (2, 4), "tetrahedron": (3, 4), "hexahedron": (3, 8),
}  # fmt: skip


class Grids(NamedTuple):
    """The grids of a file.

    Attributes
    ----------
    mesh : str
        The grid of the mesh: the first of the highest dimension.
    dim : int
        Dimension of its cells.
    num_nodes : int
        Number of its nodes.
    tags : tuple of (str, int)
        Grid and dimension of the tags.
    names : dict
        Names of groups by (dimension, tag).
    """

    mesh: str
    dim: int
    num_nodes: int
    tags: tuple[tuple[str, int], ...]
    names: dict[tuple[int, int], str]


def read(
    comm: MPI.Intracomm, path: Path, dimensions: tuple[str, ...]
) -> tuple[Any, list[PhysicalGroup]]:
    """Return the dolfinx mesh of a file and its groups. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The ranks.
    path : Path
        The .xdmf file.
    dimensions : tuple of str
        Names of the dimensions from 0 on.

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
    _check_nodes(comm, mesh, cells, grids.num_nodes)
    if x.shape[1] > grids.dim:
        if largest(comm, x[:, 2]) > FLAT * largest(comm, x):
            raise BadInput(f"it has cells {cell}: expected volumes, or nodes in the plane z = 0")
        x = x[:, : grids.dim]
    domain = _dolfinx.create_mesh(comm, cells, x, cell, degree)
    groups: dict[tuple[int, int], PhysicalGroup] = {}
    for grid, dim in grids.tags:
        nodes = on_every(comm, read_grid, grid, _dolfinx.read_xdmf_nodes, comm, path, grid)
        _check_nodes(comm, grid, nodes, grids.num_nodes)
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
    """Raise BadInput on every rank for a node number that is none of a mesh. Collective.

    dolfinx looks for the node's owner for ever, or reads beyond its arrays.
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
    grids = [(*kind, grid) for grid in root.findall("./Domain/Grid") if (kind := _kind(grid))]
    if not grids or (highest := max(dim for dim, _, _ in grids)) < 2:
        raise BadInput("it has no grid of cells: expected tetrahedra, hexahedra, or cells in 2D")
    mesh = next(grid for dim, _, grid in grids if dim == highest)
    tags, num_nodes = [], 0
    for dim, nodes, grid in grids:
        is_tagged = any(of.get("Center") == "Cell" for of in grid.findall("Attribute"))
        if grid is mesh or is_tagged:
            rows, _ = _shape(grid, "Topology", (nodes,))
        if grid is mesh:
            num_nodes, columns = _shape(grid, "Geometry", ("2", "3")[highest - 2 :])
            axes = grid.findall("Geometry")[0].get("GeometryType")
            if axes != (expected := "XYZ"[:columns]):
                raise bad_value("GeometryType", axes, f"'{expected}'")
        if is_tagged:
            tags.append((grid.get("Name") or "", dim))
            if _shape(grid, "Attribute", ("1",))[0] != rows:
                raise BadInput(f"grid '{tags[-1][0]}': expected one value for each of {rows} rows")
    names = {}
    for note in root.findall("./Domain/Information"):
        word, _, tag = (note.get("Name") or "").partition(":")
        if word in dimensions and re.fullmatch(r"-?[0-9]{1,18}", tag):
            names[dimensions.index(word), int(tag)] = note.get("Value") or tag
    return Grids(mesh.get("Name") or "", highest, num_nodes, tuple(tags), names)


def _kind(grid: ET.Element) -> tuple[int, str] | None:
    """Return the dimension of a grid's entities and their number of nodes, None for others."""
    topology = grid.find("Topology")
    kind = "" if topology is None else (topology.get("TopologyType") or "").lower()
    name, _, nodes = kind.partition("_")
    dim, vertices = _KINDS.get(name, (0, 0))
    return (dim, nodes or str(vertices)) if vertices else None


def _shape(grid: ET.Element, kind: str, columns: Collection[str]) -> tuple[int, int]:
    """Return the shape of a grid's numbers; raise BadInput unless they have so many columns.

    dolfinx crashes without a shape or a place in the HDF5 file, and for a wrong shape.
    """
    item = grid.find(f"{kind}/DataItem")
    text, place = ("", "") if item is None else (item.get("Dimensions", ""), item.text or "")
    if kind == "Attribute" and text.strip().isdecimal():
        text += " 1"
    match = re.fullmatch(r"\s*([0-9]{1,18})\s+([0-9]{1,18})\s*", text)
    if match is None or match[2] not in columns:
        wanted = " or ".join(columns)
        raise bad_value(f"grid '{grid.get('Name')}': {kind} Dimensions", text, f"rows of {wanted}")
    is_hdf = item is not None and item.get("Format") == "HDF"
    if is_hdf and not all(place.strip().partition(":")):
        raise bad_value(f"grid '{grid.get('Name')}': {kind}", place, "FILE.h5:/PATH")
    return int(match[1]), int(match[2])
