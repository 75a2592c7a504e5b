"""The surface of a body that the cells of a lattice carry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Skin:
    """A triangulated surface whose points move with the cells of a mesh; the same on all ranks.

    Attributes
    ----------
    points : (n, 3) array
        Reference positions [length].
    triangles : (m, 3) int32 array
        The points of each triangle, anticlockwise as seen from outside.
    cells : (n,) int64 array
        The cell that carries each point, by its row in the mesh's input: cells of a lattice with
        separate parts overlap, so a position alone does not tell.
    """

    points: Array
    triangles: Array
    cells: Array
