"""The text of a .vtu file of triangles."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: VTK's number of a triangle.
_TRIANGLE = 5
#: VTK's names of the types of arrays.
_TYPES = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}


def triangle_file(
    points: Array,
    triangles: Array,
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array] | None = None,
) -> str:
    """Return the text of a .vtu file.

    Parameters
    ----------
    points : (n, 3) float64
        The points [length].
    triangles : (m, 3) int
        The points of each triangle.
    point_data, cell_data : mapping of str to array
        Values at the points, (n, ...), and of the triangles, (m, ...).
    """
    n, m = len(points), len(triangles)
    mesh: list[tuple[str, list[tuple[str, Array]]]] = [
        ("Points", [("Points", points)]),
        (
            "Cells",
            [
                ("connectivity", triangles.astype(np.int64).ravel()),
                ("offsets", 3 * np.arange(1, m + 1, dtype=np.int64)),
                ("types", np.full(m, _TRIANGLE, dtype=np.uint8)),
            ],
        ),
        ("PointData", list(point_data.items())),
        ("CellData", list((cell_data or {}).items())),
    ]
    body = "".join(
        f"<{section}>\n{''.join(map(_data_array, arrays))}</{section}>\n"
        for section, arrays in mesh
    )
    return (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" '
        'byte_order="LittleEndian" header_type="UInt64">\n<UnstructuredGrid>\n'
        f'<Piece NumberOfPoints="{n}" NumberOfCells="{m}">\n{body}</Piece>\n'
        "</UnstructuredGrid>\n</VTKFile>\n"
    )


def _data_array(item: tuple[str, Array]) -> str:
    """Return an array as an element of a .vtu file, in base64."""
    name, values = item
    kind = _TYPES[values.dtype.name]
    values = values.astype(values.dtype.newbyteorder("<"))
    columns = int(np.prod(values.shape[1:], dtype=int))
    text = base64.b64encode(np.array(values.nbytes, "<u8").tobytes() + values.tobytes()).decode()
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{columns}" '
        f'format="binary">{text}</DataArray>\n'
    )
