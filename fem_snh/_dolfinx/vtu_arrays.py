"""Arrays added to the .vtu files that dolfinx writes.

dolfinx 0.5 writes no tensors per cell, and no version writes names of components or binary values.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

Buffer = bytes | memoryview


class DataArray(NamedTuple):
    """Values at the cells or the points of a mesh.

    Attributes
    ----------
    name : str
        Its name in ParaView.
    values : (n,) or (n, ...) array
        The values of this rank's cells, or of the nodes of the displacement with the ghosts.
    components : tuple of str
        Names of the components, in the order of the values; none for a scalar.
    """

    name: str
    values: np.ndarray
    components: tuple[str, ...] = ()

    def attributes(self) -> dict[str, str]:
        """Return the attributes of the element DataArray or PDataArray."""
        found = {"type": "Float64", "Name": self.name}
        if self.components:
            found["NumberOfComponents"] = str(len(self.components))
        names = {f"ComponentName{i}": name.upper() for i, name in enumerate(self.components)}
        return found | names


def insert_arrays(
    content: bytes, cells: Sequence[DataArray], points: Sequence[DataArray]
) -> list[Buffer]:
    """Return the content of a .vtu file with further arrays, in pieces.

    Their values are appended as raw binary data. Neither they nor the content are copied.
    """
    order = f'byte_order="{sys.byteorder.title()}Endian" header_type="UInt64" '
    start = b"<VTKFile "
    inserted: list[tuple[int, list[Buffer]]] = []
    inserted.append((content.index(start) + len(start), [order.encode()]))
    appended: list[Buffer] = []
    offset = 0
    for arrays, end in ((cells, b"</CellData>"), (points, b"</PointData>")):
        tags: list[Buffer] = []
        for array in arrays:
            values = np.ascontiguousarray(array.values, dtype=np.float64)
            attributes = array.attributes() | {"format": "appended", "offset": str(offset)}
            tags.append(ET.tostring(ET.Element("DataArray", attributes)))
            appended += [np.uint64(values.nbytes).tobytes(), values.data]
            offset += np.uint64(0).nbytes + values.nbytes
        inserted.append((content.rindex(end), tags))
    data: list[Buffer] = [b'<AppendedData encoding="raw">_', *appended, b"</AppendedData>"]
    inserted.append((content.rindex(b"</VTKFile>"), data))
    whole, last = memoryview(content), 0
    pieces: list[Buffer] = []
    for position, buffers in sorted(inserted, key=itemgetter(0)):
        pieces += [whole[last:position], *buffers]
        last = position
    return [*pieces, whole[last:]]


def declare_arrays(
    root: ET.Element, cells: Sequence[DataArray], points: Sequence[DataArray]
) -> None:
    """Add further arrays to the root of a .pvtu file."""
    for arrays, section in ((cells, "PCellData"), (points, "PPointData")):
        for parent in root.iter(section):
            for array in arrays:
                ET.SubElement(parent, "PDataArray", array.attributes())
