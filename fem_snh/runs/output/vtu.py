"""Files of a mesh for ParaView and PyVista: .vtu, and the .pvtu that lists the pieces of ranks.

Values are appended as raw binary data. dolfinx's VTKFile writes them as text, which takes several
times as long and as much room, and has no tensors per cell (0.5) and no names of components.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from mpi4py import MPI

import numpy as np

from fem_snh.arrays import Array
from fem_snh.errors import BadInput, on_root
from fem_snh.files import remove, replace_file

Buffer = bytes | memoryview

#: VTK's number of a triangle, as the kind of a `VtkGrid`.
TRIANGLE = 5
#: VTK's names of numpy's kinds of numbers.
_KINDS = {"f": "Float", "i": "Int", "u": "UInt"}


class DataArray(NamedTuple):
    """Values at the cells or the points of a mesh.

    Attributes
    ----------
    name : str
        The array's name in ParaView.
    values : (n,) or (n, ...) array
        The values of this rank's cells, or of its points.
    components : tuple of str
        Names of the components, in the order of the values.
    """

    name: str
    values: Array
    components: tuple[str, ...] = ()

    def attributes(self) -> dict[str, str]:
        """Return the attributes of the element DataArray or PDataArray."""
        kind = self.values.dtype
        columns = int(np.prod(self.values.shape[1:], dtype=int))
        found = {
            "type": f"{_KINDS[kind.kind]}{8 * kind.itemsize}",
            "Name": self.name,
            "NumberOfComponents": str(columns),
        }
        names = {f"ComponentName{i}": name.upper() for i, name in enumerate(self.components)}
        return found | names


class VtkGrid(NamedTuple):
    """A mesh of cells of one kind.

    Attributes
    ----------
    points : (n, 3) float
        The points [length].
    cells : (m, k) int
        The points of each cell, in VTK's order.
    kind : int
        VTK's number of the kind of cell.
    """

    points: Array
    cells: Array
    kind: int


def vtu_file(
    grid: VtkGrid, points: Sequence[DataArray] = (), cells: Sequence[DataArray] = ()
) -> list[Buffer]:
    """Return the content of a .vtu file as buffers, with values at the points and of the cells.

    The buffers are views of values that are contiguous.
    """
    count, size = grid.cells.shape
    mesh = [
        DataArray("connectivity", grid.cells.ravel()),
        DataArray("offsets", size * np.arange(1, count + 1, dtype=np.int64)),
        DataArray("types", np.full(count, grid.kind, np.uint8)),
    ]
    sections = {
        "Points": [DataArray("Points", grid.points)],
        "Cells": mesh,
        "PointData": points,
        "CellData": cells,
    }
    numbers = {"NumberOfPoints": str(len(grid.points)), "NumberOfCells": str(count)}
    root, body = _root("UnstructuredGrid")
    piece = ET.SubElement(body, "Piece", numbers)
    data: list[Buffer] = []
    offset = 0
    for section, arrays in sections.items():
        parent = ET.SubElement(piece, section)
        for array in arrays:
            values = np.ascontiguousarray(array.values)
            place = {"format": "appended", "offset": str(offset)}
            ET.SubElement(parent, "DataArray", array.attributes() | place)
            data += [np.uint64(values.nbytes).tobytes(), values.data]
            offset += np.uint64(0).nbytes + values.nbytes
    end = b"</VTKFile>"
    head = ET.tostring(root).removesuffix(end)
    return [head, b'<AppendedData encoding="raw">_', *data, b"</AppendedData>", end]


def pvtu_file(
    pieces: Sequence[str], points: Sequence[DataArray], cells: Sequence[DataArray]
) -> str:
    """Return the text of a .pvtu file: the .vtu files ``pieces``, and the types of their arrays."""
    root, body = _root("PUnstructuredGrid")
    body.set("GhostLevel", "0")
    for section, arrays in (("PPointData", points), ("PCellData", cells)):
        parent = ET.SubElement(body, section)
        for array in arrays:
            ET.SubElement(parent, "PDataArray", array.attributes())
    place = {"type": "Float64", "Name": "Points", "NumberOfComponents": "3"}
    ET.SubElement(ET.SubElement(body, "PPoints"), "PDataArray", place)
    for name in pieces:
        ET.SubElement(body, "Piece", Source=name)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _root(kind: str) -> tuple[ET.Element, ET.Element]:
    """Return the root element of a VTK file, and its child element ``kind``.

    Before version 2.2 edges of hexahedra of degree 2 were in another order.
    """
    order = f"{sys.byteorder.title()}Endian"
    about = {"type": kind, "version": "2.2", "byte_order": order, "header_type": "UInt64"}
    root = ET.Element("VTKFile", about)
    return root, ET.SubElement(root, kind)


class Collection:
    """The states of a run at increasing times, each in files of its own. Collective.

    A state is listed when its files are complete. The file can therefore be read at any time, also
    after a crash, and another run can continue it.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    path : Path
        The .pvd file.
    until : float, optional
        Keep the states of an existing file up to this time; None keeps none. The files of all
        later states are removed.

    Attributes
    ----------
    times : list of float
        Times of the states, on every rank.

    Raises
    ------
    BadInput
        On every rank, if an existing file cannot be read.
    """

    def __init__(self, comm: MPI.Comm, path: Path, until: float | None = None) -> None:
        self.comm, self.path = comm, path
        self.times: list[float] = on_root(comm, self._keep, until)
        #: The lines of the states that are listed.
        self._rows: list[str] = []

    def _keep(self, until: float | None) -> list[float]:
        """Return the times of the states that are kept; remove the files of all other states."""
        kept = []
        if until is not None and self.path.exists():
            try:
                states = list(ET.parse(self.path).iter("DataSet"))
                kept = [t for s in states if (t := float(s.attrib["timestep"])) <= until]
            except (OSError, ET.ParseError, KeyError, ValueError) as error:
                raise BadInput(f"{self.path} cannot be read ({error}): remove it") from None
        state = re.compile(re.escape(self.path.stem) + r"(?:_p\d+_)?(\d{6,})\.p?vtu")
        for path in list(self.path.parent.iterdir()):
            if (match := state.fullmatch(path.name)) and int(match[1]) >= len(kept):
                remove(path)
        return kept

    def name(self, suffix: str, part: str = "", number: int | None = None) -> str:
        """Return the name of a file, "fields<part>000012.vtu", of a state; default: the next."""
        number = len(self.times) if number is None else number
        return f"{self.path.stem}{part}{number:06}{suffix}"

    def write_next(self, t: float, content: Iterable[bytes | memoryview]) -> None:
        """Write the next state's .vtu file and list it: see `list_next`. On rank 0."""
        path = self.path.with_name(self.name(".vtu"))
        replace_file(path, lambda file: file.writelines(content))
        self.list_next(t, ".vtu")

    def list_next(self, t: float, suffix: str) -> None:
        """List the next state, whose files are complete, in the .pvd file. On rank 0.

        The caller appends to ``times`` on every rank.
        """
        times = [*self.times, t]
        for number in range(len(self._rows), len(times)):
            name = self.name(suffix, number=number)
            self._rows.append(
                f'    <DataSet timestep="{times[number]:.17g}" part="0" file="{name}" />\n'
            )
        replace_file(
            self.path,
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0">\n  <Collection>\n'
            + "".join(self._rows)
            + "  </Collection>\n</VTKFile>\n",
        )
