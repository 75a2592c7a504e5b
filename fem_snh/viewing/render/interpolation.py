"""States of a body between the stored loads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyvista as pv
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from fem_snh.errors import BadInput
from fem_snh.viewing.render.surfaces import read_grid

#: Distance up to which points of two states are the same, relative to the body's diagonal.
_SAME_POINT = 1e-6


class InterpolatedStates:
    """The stored states of a run, and those between them.

    Displacement and field are interpolated in the load by monotone cubic polynomials (PCHIP),
    which do not overshoot the stored values.

    Parameters
    ----------
    loads : sequence of float
        The stored loads, ascending, two or more.
    files : sequence of list of str
        The files of each state; states may have been written on different numbers of ranks.
    field : str
        The field beside the displacement.

    Attributes
    ----------
    displacement : (states, points, 3)
        The stored displacements [m].
    values : (states, cells or points, ...)
        The stored values of the field.

    Raises
    ------
    BadInput
        If a file cannot be read, or a state is of another mesh.
    """

    def __init__(self, loads: Sequence[float], files: Sequence[list[str]], field: str) -> None:
        grids = [read_grid(state, field) for state in files]
        self._field, self._grid = field, grids[0]
        self._per_cell = field in self._grid.cell_data
        displacements, values = [], []
        for grid, state in zip(grids, files, strict=True):
            scale = self._grid.length
            points = match_points(grid.points, self._grid.points, scale, state[0])
            displacements.append(np.asarray(grid.point_data["displacement"])[points])
            if self._per_cell:
                centres, wanted = (g.cell_centers().points for g in (grid, self._grid))
                cells = match_points(centres, wanted, scale, state[0])
                values.append(np.asarray(grid.cell_data[field])[cells])
            else:
                values.append(np.asarray(grid.point_data[field])[points])
        self.displacement, self.values = np.array(displacements), np.array(values)
        self._displacement_at = PchipInterpolator(loads, self.displacement)
        self._value_at = PchipInterpolator(loads, self.values)

    def grid(self, load: float) -> pv.UnstructuredGrid:
        """Return the reference grid with displacement and field at a load."""
        grid = self._grid.copy()
        grid.point_data["displacement"] = self._displacement_at(load)
        data = grid.cell_data if self._per_cell else grid.point_data
        data[self._field] = self._value_at(load)
        return grid


def match_points(found: np.ndarray, wanted: np.ndarray, scale: float, file: str) -> np.ndarray:
    """Return for each wanted point its index in ``found``: ranks order points differently.

    Parameters
    ----------
    found, wanted : (n, 3)
        The points of two states of one mesh.
    scale : float
        The body's diagonal.
    file : str
        A file of the found points, for the message.

    Raises
    ------
    BadInput
        If a wanted point is missing.
    """
    if found.shape == wanted.shape:
        if np.array_equal(found, wanted):
            return np.arange(len(wanted))
        distance, index = cKDTree(found).query(wanted)
        if distance.max() < _SAME_POINT * scale:
            return index
    raise BadInput(f"{file}: its mesh is not that of the other loads")
