"""The stored states of a run: read on one mesh, interpolated in the load, evaluated at points."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyvista as pv
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from fem_snh.arrays import Array
from fem_snh.errors import BadInput, bad_value
from fem_snh.records.run_record import load_record
from fem_snh.viewing.render.surfaces import boundary, read_grid
from fem_snh.viewing.stored_run import stored_loads

#: Points of two states are the same up to this distance, relative to the body's diagonal.
_SAME_POINT = 1e-6
#: A point closer to a node than this, over the body's diagonal, is the node: for rounding.
_NODE = 1e-9
#: Largest distance from the mesh, over the body's diagonal, at which a point belongs to the body:
#: two meshes of one curved surface differ by less, unless an element spans a radian.
_LARGEST_DISTANCE = 0.05

#: Subdivision level: each face of a quadratic cell becomes 4^3 triangles for closest points.
_LEVEL = 3


class ExportedState(NamedTuple):
    """The fields of a state by name, each with a row per point or per cell of ``States.mesh``."""

    point_data: dict[str, Array]
    cell_data: dict[str, Array]


class States:
    """The stored states of a run.

    Only the mesh is kept in memory. The rows of every state follow the points and cells of this
    mesh, even if the run was resumed on another number of ranks and wrote them in another order.

    Parameters
    ----------
    stored : Path or mapping
        The collection of the states (.pvd), or {load: files}.
    field : str, optional
        Read this field and the displacement only; default: all fields.
    hidden : collection of int
        Values of ``cell_group`` of the cells that are left out.

    Attributes
    ----------
    loads : list of float
        The stored loads, ascending; times [s] of a dynamic run.
    mesh : pyvista.UnstructuredGrid
        The reference mesh: the pieces of all ranks merged, without ghost cells, without fields.

    Raises
    ------
    BadInput
        If a file is missing or cannot be read.
    """

    def __init__(
        self,
        stored: Path | Mapping[float, Sequence[Path]],
        field: str | None = None,
        hidden: Collection[int] = (),
    ) -> None:
        stored = stored_loads(stored) if isinstance(stored, Path) else stored
        self.loads, self._field, self._hidden = sorted(stored), field, hidden
        self._files = [stored[load] for load in self.loads]
        first = read_grid(self._files[0], field, hidden)
        self._names = _names(first)
        self._centres: Array | None = None
        first.clear_data()
        self.mesh: pv.UnstructuredGrid = first

    def __len__(self) -> int:
        return len(self.loads)

    def read(self, number: int) -> ExportedState:
        """Return the fields of the state at ``loads[number]``.

        Raises
        ------
        BadInput
            If a file cannot be read, or the mesh or the names of the fields differ from those of
            the first state.
        """
        files = self._files[number]
        grid = read_grid(files, self._field, self._hidden)
        if _names(grid) != self._names:
            there = ", ".join(sorted(sum(_names(grid), ())))
            expected = ", ".join(sorted(sum(self._names, ())))
            raise BadInput(
                f"{files[0]}: its fields are {there}, those of the first load {expected}"
            )
        points = self._match(grid.points, self.mesh.points, files[0])
        same = np.array_equal(points, np.arange(len(points)))
        cells: slice | Array = slice(None)
        if not same or not np.array_equal(grid.cell_connectivity, self.mesh.cell_connectivity):
            if self._centres is None:
                self._centres = self.mesh.cell_centers().points
            cells = self._match(grid.cell_centers().points, self._centres, files[0])
        return ExportedState(
            {name: np.asarray(grid.point_data[name])[points] for name in self._names[0]},
            {name: np.asarray(grid.cell_data[name])[cells] for name in self._names[1]},
        )

    def displacement(self, number: int) -> Array:
        """Return the displacement of a state, (points, 3) [m]; BadInput if it is not finite."""
        u = self.read(number).point_data["displacement"]
        if not np.all(np.isfinite(u)):
            raise BadInput(f"{self._files[number][0]}: the displacement is not finite")
        return u

    def _match(self, found: Array, wanted: Array, file: Path) -> Array:
        """Return the index into ``found`` of each wanted point; BadInput if one is not found."""
        if found.shape == wanted.shape:
            if np.array_equal(found, wanted):
                return np.arange(len(wanted))
            distance, index = cKDTree(found).query(wanted)
            if distance.max() < _SAME_POINT * self.mesh.length:
                return np.asarray(index)
        raise BadInput(f"{file}: its mesh is not that of the other loads")


def _names(grid: pv.UnstructuredGrid) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the sorted names of the fields at points, and of the fields in cells."""
    return tuple(sorted(grid.point_data.keys())), tuple(sorted(grid.cell_data.keys()))


class InterpolatedStates:
    """The stored states of a run, two or more, interpolated in the load.

    Displacement and field are interpolated by monotone cubic polynomials (PCHIP), which do not
    overshoot the stored values.

    Parameters
    ----------
    stored : Path or mapping
        As for `States`.
    field : str
        The field to interpolate beside the displacement.
    hidden : collection of int
        Values of ``cell_group`` of the cells that are left out.

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

    def __init__(
        self,
        stored: Path | Mapping[float, Sequence[Path]],
        field: str,
        hidden: Collection[int] = (),
    ) -> None:
        states = States(stored, field, hidden)
        read = [states.read(number) for number in range(len(states))]
        self._field, self._grid = field, states.mesh
        self._per_cell = field in read[0].cell_data
        self.displacement = np.array([state.point_data["displacement"] for state in read])
        self.values = np.array([state[self._per_cell][field] for state in read])
        self._displacement_at = PchipInterpolator(states.loads, self.displacement)
        self._value_at = PchipInterpolator(states.loads, self.values)

    def grid(self, load: float) -> pv.UnstructuredGrid:
        """Return a copy of the reference grid with displacement and field at a load or time."""
        grid = self._grid.copy()
        grid.point_data["displacement"] = self._displacement_at(load)
        data = grid.cell_data if self._per_cell else grid.point_data
        data[self._field] = self._value_at(load)
        return grid


def displacement_at(
    run: Path, step: int, kinematics: str | None, points: Array
) -> tuple[Array, Array]:
    """Return the displacement of a stored state at points.

    At a node of the stored mesh, this is the nodal value; at any other point, it is interpolated in
    the cell that contains the point, or, outside of the mesh, taken from the closest point of the
    mesh.

    Parameters
    ----------
    run : Path
        The folder of the run.
    step : int
        The number of the state in fields.pvd, from 0; -1 is the last.
    kinematics : str or None
        The kinematics that the run must have; None in three dimensions.
    points : (n, 3) array
        Reference coordinates [m].

    Returns
    -------
    displacement : (n, 3) array
        The displacements [m].
    distance : (n,) array
        The points' distances from the mesh [m], 0 inside and within rounding.

    Raises
    ------
    BadInput
        If the run, its kinematics or the state does not fit, a file cannot be read, or a point is
        far from the mesh.
    """
    record = load_record(run / "run.json")
    if record.get("kinematics") != kinematics:
        accepted = f"a run with kinematics = {kinematics!r}, not {record.get('kinematics')!r}"
        raise bad_value("start.run", str(run), accepted.replace("None", "none"))
    states = States(run / "fields.pvd")
    if not -len(states) <= step < len(states):
        accepted = f"a number from {-len(states)} to {len(states) - 1}: {run} has"
        raise bad_value("start.step", step, f"{accepted} {len(states)} states")
    u, mesh = states.displacement(step % len(states)), states.mesh
    nodes = np.asarray(mesh.points, dtype=float)
    size = float(np.linalg.norm(np.ptp(nodes, axis=0)))
    distance, closest = cKDTree(nodes).query(points)
    found = u[closest]
    others = np.flatnonzero(distance > _NODE * size)
    distance = np.zeros(len(points))
    if len(others):
        found[others], distance[others] = _interpolate(mesh, u, points[others], _NODE * size)
    if distance.max(initial=0.0) > _LARGEST_DISTANCE * size:
        far = int(distance.argmax())
        raise BadInput(
            f"start.run = '{run}': expected a run of the same body: {points[far].tolist()} is "
            f"{distance[far]:.3g} outside of its mesh"
        )
    return found, np.where(distance > _NODE * size, distance, 0.0)


def _interpolate(mesh: Any, u: Array, points: Array, tolerance: float) -> tuple[Array, Array]:
    """Return displacements ``u`` of a mesh at points (n, 3), and the points' distances (n,)."""
    grid = mesh.copy(deep=False)
    grid.point_data["u"] = u
    sampled: Any = pv.PolyData(points).sample(grid, tolerance=tolerance)
    found, closest = np.array(sampled["u"]), points.copy()
    outside = np.flatnonzero(np.asarray(sampled["vtkValidPointMask"]) == 0)
    if len(outside):
        surface: Any = boundary(grid, _LEVEL)
        _, closest[outside] = surface.find_closest_cell(points[outside], return_closest_point=True)
        sampled = pv.PolyData(closest[outside]).sample(surface, snap_to_closest_point=True)
        found[outside] = sampled["u"]
    return found, np.linalg.norm(points - closest, axis=1)
