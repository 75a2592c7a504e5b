"""The files of a lattice's skin: skin.pvd with one .vtu for each state."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.contact.embedded_surface import EmbeddedSurface, carried_points
from fem_snh.errors import on_root
from fem_snh.mesh.skin import Skin
from fem_snh.pvd import Collection
from fem_snh.run_files import RunFiles
from fem_snh.runs.output.triangle_file import triangle_file

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
        self, u: Array, t: float, cells: Mapping[str, Array], nodes: Mapping[str, Array]
    ) -> None:
        """Append a state. Collective.

        Parameters
        ----------
        u : (local nodes, 3)
            The displacement [m].
        t : float
            The time.
        cells, nodes : mapping of str to array
            Values at this rank's own cells, (cells, ...), and at its nodes, (local nodes, ...).

        Raises
        ------
        BadInput
            On every rank, if a file cannot be written.
        """
        fields: dict[str, Array | None] = {
            "displacement": self._surface.interpolate(self._surface.support.gather(u))
        }
        for name, values in cells.items():
            fields[name] = self._carried(values)
        for name, values in nodes.items():
            fields[name] = self._interpolated(values)
        on_root(self.comm, self._write, fields, t)
        self.times.append(t)

    def _carried(self, values: Array) -> Array | None:
        """Return the values of the cells that carry the points, on rank 0."""
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

    def _write(self, fields: Mapping[str, Any], t: float) -> None:
        """Write the state's file, then the collection."""
        self.write_next(t, triangle_file(self._skin.points, self._skin.triangles, fields))
