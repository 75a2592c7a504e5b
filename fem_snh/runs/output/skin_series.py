"""The series of surfaces: skin.pvd of a body in a lattice, and obstacles.pvd of its obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.contact.gathered_surface import EmbeddedSurface, carried_points
from fem_snh.errors import on_root
from fem_snh.geometry.motions import MovingShape, Pose
from fem_snh.geometry.shapes import Revolved
from fem_snh.geometry.shapes.triangles import join, surface_triangles
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.problem.initial_state import bounding_box
from fem_snh.problem.problem import Problem
from fem_snh.runs.output.vtu import TRIANGLE, Collection, DataArray, VtkGrid, vtu_file


class SkinSeries(Collection):
    """The surface of a body in a lattice at increasing times, with fields at points. Collective.

    Rank 0 writes triangles in the reference configuration. A field of the cells has at each point
    the value of the cell that contains the point.

    Parameters
    ----------
    path : Path
        The .pvd file.
    V : dolfinx function space
        The displacement's space.
    skin : Skin
        The surface: triangles whose points move with the cells of the lattice.
    until : float, optional
        Keep the states of an existing file up to this time.
    """

    def __init__(
        self,
        path: Path,
        V: _dolfinx.FunctionSpace,
        skin: Skin,
        until: float | None = None,
    ) -> None:
        super().__init__(V.mesh.comm, path, until)
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
        u : (nodes, 3)
            The displacement [m] of this rank's nodes, ghosts included.
        points, cells : sequence of DataArray
            Values at this rank's nodes, ghosts included; and of this rank's owned cells.

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
        """Return for each point its cell's value, (points, ...), on rank 0; else None."""
        parts = self.comm.gather((self._points, values[self._cells]))
        if parts is None:
            return None
        found = np.empty((len(self._skin.points), *values.shape[1:]))
        for points, part in parts:
            found[points] = part
        return found

    def _interpolated(self, values: Array) -> Array:
        """Return nodal values interpolated at the points, (points, ...). Collective.

        Three columns are interpolated at a time, as for displacements.
        """
        columns = values.reshape(len(values), -1)
        wide = np.pad(columns, ((0, 0), (0, -columns.shape[1] % 3)))
        parts = [
            self._surface.interpolate(self._surface.support.gather(wide[:, i : i + 3]))
            for i in range(0, wide.shape[1], 3)
        ]
        found: Array = np.concatenate(parts, axis=1)[:, : columns.shape[1]]
        return found.reshape(-1, *values.shape[1:])

    def _write(self, fields: Sequence[DataArray], t: float) -> None:
        """Write the state's file, then the collection. On rank 0."""
        grid = VtkGrid(self._skin.points, self._skin.triangles, TRIANGLE)
        self.write_next(t, vtu_file(grid, fields))


#: Unbounded surfaces are cut off at this many times half of the diagonal of the body's box.
_REACH = 1.5


class ObstacleSeries(Collection):
    """The surfaces of moving obstacles at increasing times. Collective.

    Rank 0 writes triangles at their present positions; the field ``obstacle`` is the number of the
    obstacle, in the order of run.json.

    Parameters
    ----------
    path : Path
        The .pvd file.
    comm : MPI communicator
        The problem's communicator.
    obstacles : sequence of MovingShape
        The obstacles.
    until : float, optional
        Keep the states of an existing file up to this time.
    """

    def __init__(
        self,
        path: Path,
        comm: MPI.Comm,
        obstacles: Sequence[MovingShape],
        until: float | None = None,
    ) -> None:
        super().__init__(comm, path, until)
        self._obstacles = obstacles
        #: The triangles of bounded surfaces by obstacle, at their reference position.
        self._made: dict[int, tuple[Array, Array]] = {}

    def write(self, problem: Problem, t: float) -> None:
        """Append the obstacles at the problem's load. Collective.

        Raises
        ------
        BadInput
            On every rank, if a file cannot be written.
        """
        u = problem.x.array_r[: problem.owned_displacements]
        x = problem.coordinates + problem.kinematics.padded(u)
        box = np.array(bounding_box(self.comm, x))
        on_root(self.comm, self._write, problem.load, t, box)
        self.times.append(t)

    def _write(self, load: float, t: float, box: Array) -> None:
        """Write the state's file, then the collection. On rank 0."""
        parts = []
        for i, obstacle in enumerate(self._obstacles):
            pose = obstacle.pose(load)
            if isinstance(obstacle.shape, Revolved):  # it turns about its own axis
                pose = Pose(np.eye(3), pose.translation)
            X, triangles = self._triangles(
                i, pose.invert(box.mean(axis=0)[None])[0], np.ptp(box, 0)
            )
            parts.append((pose.apply(X), triangles))
        numbers = np.repeat(np.arange(len(parts)), [len(triangles) for _, triangles in parts])
        grid = VtkGrid(*join(parts), TRIANGLE)
        self.write_next(t, vtu_file(grid, cells=[DataArray("obstacle", numbers)]))

    def _triangles(self, i: int, centre: Array, size: Array) -> tuple[Array, Array]:
        """Return points (n, 3) and triangles (m, 3) of obstacle ``i`` at its reference position.

        Unbounded surfaces are cut off near ``centre``, by the ``size`` of the body's bounding box.
        """
        if i not in self._made:
            shape, radius = self._obstacles[i].shape, _REACH / 2 * float(np.linalg.norm(size))
            if isinstance(shape, Revolved):
                shape = shape.section
            found = surface_triangles(shape, centre, radius)
            if not np.isfinite(shape.bounds).all():
                return found
            self._made[i] = found
        return self._made[i]
