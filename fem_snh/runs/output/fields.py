"""The files of a run for ParaView and PyVista: fields.pvd and modes.pvd with their pieces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.regions import Region
from fem_snh.errors import on_every, on_root
from fem_snh.files import replace_file
from fem_snh.mesh.mesh import Mesh
from fem_snh.problem.problem import Problem
from fem_snh.records.output_fields import CELL_GROUP, ERRORS, SUMMED
from fem_snh.runs.output.vtu import Collection, DataArray, VtkGrid, pvtu_file, vtu_file

if TYPE_CHECKING:
    from fem_snh.problem.modes import VibrationModes
    from fem_snh.runs.output.field_values import RequestedFields
    from fem_snh.runs.output.skin_series import ObstacleSeries, SkinSeries
    from fem_snh.runs.setup import Setup


#: The time series of the surface of a body in a lattice, and of the surfaces of obstacles.
SKIN, OBSTACLES = "skin.pvd", "obstacles.pvd"


def error_field(goal: str) -> str:
    """Return the name of the field with a goal's error: "error_corner_y" for "corner.y"."""
    return ERRORS + goal.replace(".", "_")


class Fields:
    """The series fields.pvd, and skin.pvd and obstacles.pvd beside it. Collective.

    `write` appends a state to each series. The times of the series are loads; in a dynamic scene,
    times [s]. fields.pvd has these fields:

    - ``displacement`` [length] at the nodes;
    - ``J`` = det F and, if there is an energy, ``energy_density`` [Pa]: means over each cell;
    - ``min_J`` and ``min_eigenvalue``: smallest J, and smallest eigenvalue of the Hessian of the
      energy density [Pa], at a quadrature point of each cell;
    - ``pressure`` [Pa] at the nodes, if the formulation has a pressure unknown;
    - the fields that the scene names, ``error_<goal>`` and ``cell_group``.

    skin.pvd, for a body in a lattice, has the fields at the points of the body's surface.
    obstacles.pvd, if there are obstacles, has the obstacles' surfaces at their present positions.

    Parameters
    ----------
    path : Path
        The .pvd file.
    setup : Setup
        The scene and its problem.
    resumed : bool, optional
        Keep the states of existing files up to the problem's load.
    goals : sequence of str, optional
        Goals whose errors are written. The state at load 1 is then written by `write_errors`; the
        errors of states before it are zero.

    Attributes
    ----------
    group_names : list of list of str
        The names of `CellGroups`, by the values of ``cell_group``; empty if all cells are in one
        part, and the field is not written.
    """

    def __init__(
        self,
        path: Path,
        setup: Setup,
        resumed: bool = False,
        goals: Sequence[str] = (),
    ) -> None:
        problem, motion = setup.problem, setup.stepper.motion
        #: The time in the files at load 1.
        self._duration = motion.duration if motion else 1.0
        energy = ["energy_density"] if problem.has_energy else []
        self._names = ["J", "min_J", *energy, "min_eigenvalue"]
        groups: CellGroups | None = None
        if setup.mesh.has_parts or len(problem.regions) > 1:
            groups = cell_groups(setup.mesh, problem.regions)
        self.group_names = groups.names if groups else []
        self._groups = [DataArray(CELL_GROUP, groups.numbers)] if groups else []
        #: Errors in the cells by goal; and whether the state at load 1 waits for `write_errors`.
        self._errors: Mapping[str, Array] = {}
        self._goals, self._waits = goals, bool(goals)
        self._num_owned = _dolfinx.num_nodes(problem.V)[0]
        if problem.saddle_point:
            self._pressure = _dolfinx.function(problem.saddle_point.Q, "pressure")
            self._at_nodes = _dolfinx.function(problem.V, "pressure")
        until = problem.load * self._duration if resumed else None
        self._series = GridSeries(path, problem.V, until)
        self._obstacles: ObstacleSeries | None = None
        shapes = [shape for term in problem.terms for shape in term.surfaces]
        if shapes:
            from fem_snh.runs.output.skin_series import ObstacleSeries

            self._obstacles = ObstacleSeries(path.with_name(OBSTACLES), problem.comm, shapes, until)
        self._skin: SkinSeries | None = None
        if problem.skin is not None:
            from fem_snh.runs.output.skin_series import SkinSeries

            self._skin = SkinSeries(path.with_name(SKIN), problem.V, problem.skin, until)
        self._requested: RequestedFields | None = None
        if setup.scene.fields:
            from fem_snh.runs.output.field_values import RequestedFields

            chosen = setup.scene.fields, setup.scene.fields_at
            moving = {"velocity": motion.v, "acceleration": motion.a} if motion else {}
            self._requested = RequestedFields(problem, *chosen, moving)

    def write(self, problem: Problem) -> None:
        """Append the problem's state to each series that lacks the state's time. Collective.

        A killed run may have written the state into some of the series. With goals the state at
        load 1 is not written: see `write_errors`.
        """
        if self._waits and problem.load == 1:
            return
        time = problem.load * self._duration
        if self._obstacles and time not in self._obstacles.times:
            self._obstacles.write(problem, time)
        lacking = [s for s in (self._series, self._skin) if s and time not in s.times]
        if not lacking:
            return
        fields = problem.cell_fields(problem.x)
        values = {
            "J": fields["deformed_volume"] / fields["volume"],
            "min_J": fields["min_J"],
            "energy_density": fields["energy"] / fields["volume"],
            "min_eigenvalue": fields["min_eigenvalue"],
        }
        u = problem.kinematics.padded(problem.u.x.array)
        cells = [DataArray(name, values[name]) for name in self._names]
        nodes = self._nodal_pressure(problem)
        further = self._requested.arrays() if self._requested else ([], [])
        if self._series in lacking:
            none = np.zeros(len(fields["volume"]))
            errors = [DataArray(error_field(g), self._errors.get(g, none)) for g in self._goals]
            points = [DataArray("displacement", u), *nodes, *self._without_copies(further[1])]
            self._series.write(time, points, [*cells, *errors, *self._groups, *further[0]])
        if self._skin in lacking:
            self._skin.write(time, u, [*further[1], *nodes], [*cells, *further[0]])

    def _nodal_pressure(self, problem: Problem) -> list[DataArray]:
        """Return the pressure unknown at the displacement's nodes; nothing if there is none."""
        if not problem.saddle_point:
            return []
        self._pressure.x.array[:] = problem.saddle_point.pressure()
        self._at_nodes.sub(0).interpolate(self._pressure)
        components = problem.kinematics.components
        return [DataArray("pressure", self._at_nodes.x.array.reshape(-1, components)[:, 0])]

    def write_errors(self, problem: Problem, indicators: Mapping[str, Array]) -> None:
        """Write the state with the errors of goals in this rank's cells. Collective.

        Goals that ``indicators`` lacks have zeros.
        """
        self._errors, self._waits = indicators, False
        self.write(problem)

    def _without_copies(self, arrays: list[DataArray]) -> list[DataArray]:
        """Return arrays at the nodes; those of `SUMMED` are copies with zeros at the ghosts."""
        found = []
        for array in arrays:
            if array.name in SUMMED:
                values = array.values.copy()
                values[self._num_owned :] = 0.0
                array = array._replace(values=values)
            found.append(array)
        return found


def write_modes(path: Path, problem: Problem, modes: VibrationModes) -> None:
    """Write the mode shapes to a .pvd file, at the times 1, 2, ... Collective.

    Each time has the mode shape ``mode`` [length] and the displacement about which the body
    vibrates. The mass-weighted mean of ``mode`` squared is ``Problem.length`` squared.

    Parameters
    ----------
    path : Path
        The .pvd file.
    problem : Problem
        The problem, in the state about which the body vibrates.
    modes : VibrationModes
        The eigenfrequencies and mode shapes.
    """
    series = GridSeries(path, problem.V)
    for number, shape in enumerate(modes.shapes, 1):
        shapes = {"displacement": problem.u, "mode": shape}
        points = [
            DataArray(name, problem.kinematics.padded(function.x.array))
            for name, function in shapes.items()
        ]
        series.write(float(number), points)


class GridSeries(Collection):
    """Values at the nodes and of the cells of a mesh at increasing times. Collective.

    Another run can continue the series on another number of ranks. A node that ranks share is a
    point in the piece of each; ``vtkGhostType`` is 1 in the pieces of ranks that do not own it.

    Parameters
    ----------
    path : Path
        The .pvd file.
    V : dolfinx function space
        A Lagrange space, whose nodes are the points.
    until : float, optional
        Keep the states of an existing file up to this time.
    """

    def __init__(
        self,
        path: Path,
        V: _dolfinx.FunctionSpace,
        until: float | None = None,
    ) -> None:
        super().__init__(V.mesh.comm, path, until)
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
            Values at this rank's nodes, ghosts included; and of this rank's owned cells.

        Raises
        ------
        BadInput
            On every rank, if a rank cannot write its file.
        """
        points = [*points, *self._marks]
        names = [self.name(".vtu", f"_p{rank}_") for rank in range(self.comm.size)]
        state = self.name(".pvtu")
        content = vtu_file(self._grid, points, cells)
        piece = self.path.with_name(names[self.comm.rank])
        on_every(self.comm, replace_file, piece, lambda file: file.writelines(content))
        on_root(self.comm, self._list, t, state, pvtu_file(names, points, cells))
        self.times.append(t)

    def _list(self, t: float, state: str, text: str) -> None:
        """Write the state's .pvtu, then the .pvd. On rank 0."""
        replace_file(self.path.with_name(state), text)
        self.list_next(t, ".pvtu")


class CellGroups(NamedTuple):
    """The parts of a mesh: cells of the same physical groups and of the same material.

    Attributes
    ----------
    names : list of list of str
        The names of the groups of each part; then of its material, if the body has several.
    numbers : (n,) int array
        Index into ``names`` for each cell that this rank owns.
    """

    names: list[list[str]]
    numbers: Array


def cell_groups(mesh: Mesh, regions: list[Region]) -> CellGroups | None:
    """Return the parts of a mesh; None if all cells are in one. Collective.

    Parameters
    ----------
    mesh : Mesh
        The mesh with its physical groups, which may overlap.
    regions : list of Region
        The owned cells of each material. Rigid cells are in no region.
    """
    count = _dolfinx.num_owned(mesh.domain)
    groups = [group for group in mesh.groups if group.dim == mesh.dim and group.count]
    # A column for each group, and one with the number of the material.
    kind = np.zeros((count, len(groups) + 1), dtype=np.int32)
    for column, group in enumerate(groups):
        kind[group.entities[group.entities < count], column] = 1
    for number, region in enumerate(regions, 1):
        kind[region.cells, -1] = number
    gathered = np.concatenate(mesh.domain.comm.allgather(np.unique(kind, axis=0)))
    parts, numbers = np.unique(np.concatenate([gathered, kind]), axis=0, return_inverse=True)
    if len(parts) < 2:
        return None
    names = []
    for *members, material in parts:
        found = [group.name for group, member in zip(groups, members, strict=True) if member]
        if material and len(regions) > 1:
            found.append(regions[material - 1].material.numbers.name)
        names.append(found)
    return CellGroups(names, numbers.ravel()[len(gathered) :])
