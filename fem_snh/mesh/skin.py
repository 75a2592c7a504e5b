"""The surface of a body that the cells of a lattice carry, and nodes of a lattice in one place."""

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


@dataclass(frozen=True)
class NodeCopies:
    """Nodes of a lattice that are not at the part of the body to which their cells belong.

    Parts of a body that pass through one cube of a lattice have cells of their own there, with
    nodes with the same coordinates. One of these is at its own part of the body, the others are
    copies.

    Attributes
    ----------
    cells : (n,) int array
        Cells with such nodes, by their rows in the mesh's input.
    copied : (n, 27) bool array
        Which of a cell's nodes of degree 2 are copies, sorted by their reference coordinates.
    """

    cells: Array
    copied: Array
