"""The files of a mesh at increasing times: a .pvd, and the pieces of all ranks of each state."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fem_snh import _dolfinx
from fem_snh.atomic_files import replace_file
from fem_snh.errors import on_every, on_root
from fem_snh.pvd import Collection
from fem_snh.run_files import RunFiles
from fem_snh.runs.output.vtu import DataArray, VtkGrid, pvtu_file, vtu_file


class GridSeries(Collection):
    """Values at the nodes and of the cells of a mesh at increasing times. Collective.

    Another run can continue the series on another number of ranks. Nodes between ranks are points
    of each of them, marked by ``vtkGhostType`` on those that do not own them.

    Parameters
    ----------
    path : Path
        The .pvd file.
    V : dolfinx function space
        A Lagrange space, whose nodes are the points.
    until : float, optional
        Keep the states of an existing file up to this time.
    files : RunFiles, optional
        The run's files.
    """

    def __init__(
        self, path: Path, V: Any, until: float | None = None, files: RunFiles | None = None
    ) -> None:
        super().__init__(V.mesh.comm, path, until, files)
        self._grid = VtkGrid(*_dolfinx.vtk_mesh(V))
        self._marks: list[DataArray] = []
        if self.comm.size > 1:
            owned, ghosts = _dolfinx.num_nodes(V)
            ghost = np.repeat(np.array([0, 1], np.uint8), [owned, ghosts])
            self._marks.append(DataArray("vtkGhostType", ghost))

    def write(self, t: float, points: Sequence[DataArray], cells: Sequence[DataArray] = ()) -> None:
        """Append a state. Collective.

        Parameters
        ----------
        t : float
            The time.
        points, cells : sequence of DataArray
            Values at this rank's nodes, ghosts included, and of its cells.

        Raises
        ------
        BadInput
            On every rank, if one of them cannot write its file.
        """
        points = [*points, *self._marks]
        names = [self.name(".vtu", f"_p{rank}_") for rank in range(self.comm.size)]
        state = self.name(".pvtu")
        on_root(self.comm, self.announce, state, *names)
        content = vtu_file(self._grid, points, cells)
        piece = self.path.with_name(names[self.comm.rank])
        on_every(self.comm, replace_file, piece, lambda file: file.writelines(content))
        on_root(self.comm, self._list, t, state, pvtu_file(names, points, cells))
        self.times.append(t)

    def _list(self, t: float, state: str, text: str) -> None:
        """Write the state's .pvtu, then the .pvd. On rank 0."""
        replace_file(self.path.with_name(state), text)
        self.list_next(t, ".pvtu")
