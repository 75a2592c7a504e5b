"""Arrays added to the .vtu files that dolfinx writes.

dolfinx 0.5 writes no tensors per cell, and no version writes names of components or binary values.
"""

from __future__ import annotations

import base64
import sys
from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np


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


def insert_arrays(content: bytes, cells: Sequence[DataArray], points: Sequence[DataArray]) -> bytes:
    """Return the content of a .vtu file with further arrays, which are binary."""
    binary = f'<VTKFile byte_order="{sys.byteorder.title()}Endian" header_type="UInt64" '
    content = content.replace(b"<VTKFile ", binary.encode(), 1)
    for arrays, end in ((cells, b"</CellData>"), (points, b"</PointData>")):
        if arrays:
            before, _, after = content.rpartition(end)
            content = b"".join([before, *map(_element, arrays), end, after])
    return content


def _element(array: DataArray) -> bytes:
    """Return the XML element of an array: the number of bytes, then the values, in base 64."""
    values = np.ascontiguousarray(array.values, dtype=np.float64)
    element = ET.Element("DataArray", array.attributes() | {"format": "binary"})
    element.text = base64.b64encode(np.uint64(values.nbytes).tobytes() + values.tobytes()).decode()
    return ET.tostring(element)


def declare_arrays(
    root: ET.Element, cells: Sequence[DataArray], points: Sequence[DataArray]
) -> None:
    """Add further arrays to the root of a .pvtu file."""
    for arrays, section in ((cells, "PCellData"), (points, "PPointData")):
        for parent in root.iter(section):
            for array in arrays:
                ET.SubElement(parent, "PDataArray", array.attributes())
