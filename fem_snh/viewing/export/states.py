"""The stored states of a run on one mesh, read one at a time."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyvista as pv

from fem_snh.errors import BadInput
from fem_snh.viewing.render import stored_loads
from fem_snh.viewing.render.interpolation import match_points
from fem_snh.viewing.render.surfaces import read_grid


class ExportedState(NamedTuple):
    """The fields of a state by name: one row for each point or cell of the mesh."""

    point_data: dict[str, np.ndarray]
    cell_data: dict[str, np.ndarray]


class States:
    """The stored states of a run.

    Only the mesh is kept in memory. Every state is given on this mesh, also where the run was
    resumed on another number of ranks, which order points and cells differently.

    Parameters
    ----------
    pvd : Path
        The collection of the states.

    Attributes
    ----------
    loads : list of float
        The stored loads, ascending.
    mesh : pyvista.UnstructuredGrid
        The reference mesh: the pieces of all ranks merged, without ghost cells, without fields.

    Raises
    ------
    BadInput
        If a file is missing or cannot be read.
    """

    def __init__(self, pvd: Path) -> None:
        stored = stored_loads(pvd)
        self.loads = sorted(stored)
        self._files = [[str(file) for file in stored[load]] for load in self.loads]
        first = read_grid(self._files[0], None)
        self._names = _names(first)
        self._centres: np.ndarray | None = None
        first.clear_data()
        self.mesh: pv.UnstructuredGrid = first

    def __len__(self) -> int:
        return len(self.loads)

    def read(self, number: int) -> ExportedState:
        """Return the fields of a state.

        Raises
        ------
        BadInput
            If a file cannot be read, the state is of another mesh, or it has other fields than
            the first one.
        """
        files = self._files[number]
        grid = read_grid(files, None)
        if _names(grid) != self._names:
            there = ", ".join(sorted(sum(_names(grid), ())))
            expected = ", ".join(sorted(sum(self._names, ())))
            raise BadInput(
                f"{files[0]}: its fields are {there}, those of the first load {expected}"
            )
        points = self._match(grid.points, self.mesh.points, files[0])
        same = np.array_equal(points, np.arange(len(points)))
        cells: slice | np.ndarray = slice(None)
        if not same or not np.array_equal(grid.cell_connectivity, self.mesh.cell_connectivity):
            if self._centres is None:
                self._centres = self.mesh.cell_centers().points
            cells = self._match(grid.cell_centers().points, self._centres, files[0])
        return ExportedState(
            {name: np.asarray(grid.point_data[name])[points] for name in self._names[0]},
            {name: np.asarray(grid.cell_data[name])[cells] for name in self._names[1]},
        )

    def displacement(self, number: int) -> np.ndarray:
        """Return the displacement of a state (points, 3) [m]; BadInput if it is not finite."""
        u = self.read(number).point_data["displacement"]
        if not np.all(np.isfinite(u)):
            raise BadInput(f"{self._files[number][0]}: the displacement is not finite")
        return u

    def _match(self, found: np.ndarray, wanted: np.ndarray, file: str) -> np.ndarray:
        return match_points(found, wanted, self.mesh.length, file)


def _names(grid: pv.UnstructuredGrid) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the fields at points and at cells."""
    return tuple(sorted(grid.point_data.keys())), tuple(sorted(grid.cell_data.keys()))
