"""The files of a lattice's skin: skin.pvd with one .vtu for each state."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.contact.gathered_surface import EmbeddedSurface, carried_points
from fem_snh.errors import on_root
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.records.run_files import RunFiles
from fem_snh.runs.output.pvd import Collection
from fem_snh.runs.output.vtu import TRIANGLE, DataArray, VtkGrid, vtu_file

Array = npt.NDArray[Any]


class SkinSeries(Collection):
    """The skin of a body at increasing times, as triangles with fields at the points. Collective.

    Rank 0 writes. A field of the cells has at each point the value of the cell that carries it.

    Parameters
    ----------
    path : Path
        The .pvd file.
    V : dolfinx function space
        The displacement's space.
    skin : Skin
        The skin.
    until : float, optional
        Keep the states of an existing file up to this time.
    files : RunFiles, optional
        The run's files.
    """

    def __init__(
        self,
        path: Path,
        V: Any,
        skin: Skin,
        until: float | None = None,
        files: RunFiles | None = None,
    ) -> None:
        super().__init__(V.mesh.comm, path, until, files)
        self._skin = skin
        self._surface = EmbeddedSurface.of_skin(V, skin)
        self._points, self._cells = carried_points(V.mesh, skin)

    def write(
        self, t: float, u: Array, points: Sequence[DataArray], cells: Sequence[DataArray]
    ) -> None:
        """Append a state. Collective.

        Parameters
        ----------
        t : float
            The time.
        u : (local nodes, 3)
            The displacement [m].
        points, cells : sequence of DataArray
            Values at this rank's nodes, ghosts included, and of its cells.

        Raises
        ------
        BadInput
            On every rank, if a file cannot be written.
        """
        moved = self._surface.interpolate(self._surface.support.gather(u))
        fields = [
            DataArray("displacement", moved),
            *(array._replace(values=self._carried(array.values)) for array in cells),
            *(array._replace(values=self._interpolated(array.values)) for array in points),
        ]
        on_root(self.comm, self._write, fields, t)
        self.times.append(t)

    def _carried(self, values: Array) -> Any:
        """Return the values of the cells that carry the points, on rank 0 alone."""
        parts = self.comm.gather((self._points, values[self._cells]))
        if parts is None:
            return None
        found = np.empty((len(self._skin.points), *values.shape[1:]))
        for points, part in parts:
            found[points] = part
        return found

    def _interpolated(self, values: Array) -> Array:
        """Return nodal values at the points: three columns at a time, as displacements."""
        columns = values.reshape(len(values), -1)
        wide = np.pad(columns, ((0, 0), (0, -columns.shape[1] % 3)))
        parts = [
            self._surface.interpolate(self._surface.support.gather(wide[:, i : i + 3]))
            for i in range(0, wide.shape[1], 3)
        ]
        found: Array = np.concatenate(parts, axis=1)[:, : columns.shape[1]]
        return found.reshape(-1, *values.shape[1:])

    def _write(self, fields: Sequence[DataArray], t: float) -> None:
        """Write the state's file, then the collection."""
        grid = VtkGrid(self._skin.points, self._skin.triangles, TRIANGLE)
        self.write_next(t, vtu_file(grid, fields))
