"""Meshes in XDMF files: every rank reads its part of cells, nodes and groups, and none reads all.

The text of the file lists grids; the numbers are in HDF5 files. A grid is the mesh; each grid with
an attribute of cells has tags of some entities (dolfinx's meshtags). Tags of equal value are a
group, which an ``Information`` names: ``Name="surface:3"``, ``Value="left"``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.errors import BadInput, on_every, on_root
from fem_snh.files import check_regular, xdmf_data, xdmf_root

Array = npt.NDArray[Any]

#: Dimension of the entities of a grid by XDMF's types of topology, which may have a suffix.
_DIMENSIONS = {
    "polyvertex": 0, "polyline": 1, "edge": 1, "triangle": 2, "quadrilateral": 2,
    "tetrahedron": 3, "hexahedron": 3,
}  # fmt: skip
#: Largest extent along z of a mesh in the plane, relative to its coordinates: rounding.
_FLAT = 1e-12


class Grids(NamedTuple):
    """The grids of a file.

    Attributes
    ----------
    mesh : str
        The grid of the mesh: the first of the highest dimension.
    dim : int
        Dimension of its cells.
    tags : tuple of (str, int)
        Grid and dimension of the tags.
    names : dict
        Names of groups by (dimension, tag).
    """

    mesh: str
    dim: int
    tags: tuple[tuple[str, int], ...]
    names: dict[tuple[int, int], str]


class Tagged(NamedTuple):
    """The entities of a group on one rank: local numbers, sorted, ghosts included."""

    name: str
    dim: int
    tag: int
    entities: Array


def read(comm: MPI.Intracomm, path: Path, dimensions: tuple[str, ...]) -> tuple[Any, list[Tagged]]:
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

    def read_arrays() -> Any:
        try:
            return _dolfinx.read_xdmf(comm, path, grids.mesh)
        except RuntimeError as error:
            raise BadInput(f"grid '{grids.mesh}': {error}") from None

    def read_tags(grid: str, dim: int) -> tuple[Array, Array]:
        try:
            return _dolfinx.read_xdmf_tags(domain, path, grid, dim)
        except RuntimeError as error:
            raise BadInput(f"grid '{grid}': {error}") from None

    cells, x, cell, degree = on_every(comm, read_arrays)
    if x.shape[1] > grids.dim:
        ends = np.array([np.abs(x[:, 2]).max(initial=0.0), np.abs(x).max(initial=0.0)])
        height, size = _largest(comm, ends)
        if height > _FLAT * size:
            raise BadInput(f"it has cells {cell}: expected volumes, or nodes in the plane z = 0")
        x = x[:, : grids.dim]
    domain = _dolfinx.create_mesh(comm, cells, x, cell, degree)
    groups: dict[tuple[int, int], Tagged] = {}
    for grid, dim in grids.tags:
        entities, values = on_every(comm, read_tags, grid, dim)
        found = comm.allgather(np.unique(values))
        for tag in np.unique(np.concatenate(found)).tolist():
            if (dim, tag) in groups:
                raise BadInput(
                    f"grid '{grid}' = {dimensions[dim]} {tag}: expected each number in one grid "
                    "of a dimension"
                )
            name = grids.names.get((dim, tag), str(tag))
            chosen = np.sort(entities[values == tag]).astype(np.int32)
            groups[dim, tag] = Tagged(name, dim, tag, chosen)
    return domain, list(groups.values())


def _largest(comm: MPI.Intracomm, values: Array) -> Array:
    """Return the largest of each value over the ranks. Collective."""
    largest = np.empty_like(values)
    comm.Allreduce(values, largest, op=MPI.MAX)
    return largest


def _read_grids(path: Path, dimensions: tuple[str, ...]) -> Grids:
    """Return the grids of a file. Raises BadInput and OSError."""
    try:
        root = xdmf_root(path)
    except ValueError as error:
        raise BadInput(f"this is not an XDMF file: {error}") from None
    for file in xdmf_data(path):
        check_regular(file)
    grids: list[tuple[str, int, bool]] = []
    for grid in root.findall("./Domain/Grid"):
        topology = grid.find("Topology")
        kind = "" if topology is None else (topology.get("TopologyType") or "").lower()
        dim = _DIMENSIONS.get(kind.partition("_")[0])
        if dim is not None:
            tagged = any(of.get("Center") == "Cell" for of in grid.findall("Attribute"))
            grids.append((grid.get("Name") or "", dim, tagged))
    if not grids or (highest := max(dim for _, dim, _ in grids)) < 2:
        raise BadInput("it has no grid of cells: expected tetrahedra, hexahedra, or cells in 2D")
    mesh = next(name for name, dim, _ in grids if dim == highest)
    names = {}
    for note in root.findall("./Domain/Information"):
        word, _, tag = (note.get("Name") or "").partition(":")
        if word in dimensions and tag.lstrip("-").isdecimal():
            names[dimensions.index(word), int(tag)] = note.get("Value") or tag
    tags = tuple((name, dim) for name, dim, tagged in grids if tagged)
    return Grids(mesh, highest, tags, names)
