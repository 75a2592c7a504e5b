"""The files of a run for ParaView and PyVista: fields.pvd and modes.pvd with their pieces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.output_fields import CELL_GROUP, ERRORS, SUMMED
from fem_snh.problem.problem import Problem
from fem_snh.run_files import RunFiles
from fem_snh.terms.history import SurfaceTerm

if TYPE_CHECKING:
    from fem_snh.problem.modes import VibrationModes
    from fem_snh.runs.output.cell_groups import CellGroups
    from fem_snh.runs.output.field_values import RequestedFields
    from fem_snh.runs.output.obstacle_series import ObstacleSeries
    from fem_snh.runs.output.skin_series import SkinSeries
    from fem_snh.runs.setup import Setup

Array = npt.NDArray[Any]

#: The time series of the skin that a lattice carries, and of the surfaces of obstacles.
SKIN, OBSTACLES = "skin.pvd", "obstacles.pvd"


def error_field(goal: str) -> str:
    """Return the name of the field with a goal's error, ``error_corner_y``."""
    return ERRORS + goal.replace(".", "_")


class Fields:
    """The time series fields.pvd, with the load as time; in time, with the time [s]. Collective.

    Its fields are the displacement [length] at the nodes; means over each cell of J = det F and of
    the energy density [Pa]; the smallest J and the smallest eigenvalue of the Hessian of the energy
    density at a quadrature point of each cell; and, if the pressure is unknown, the pressure [Pa]
    at the nodes of the displacement.
    Of a body in a lattice, skin.pvd has the same fields at the points of its surface. If there are
    obstacles, obstacles.pvd has their surfaces at the same times, where they then are.

    Parameters
    ----------
    path : Path
        The .pvd file.
    setup : Setup
        The scene, which names further fields, and its problem.
    resumed : bool, optional
        Keep the states of an existing file up to the problem's load.
    files : RunFiles, optional
        The run's files.
    goals : sequence of str, optional
        Goals whose errors are written for each cell, as ``error_<goal>``. The state at load 1 is
        then written by `write_errors`; before it they are zero.

    Attributes
    ----------
    group_names : list of list of str
        See `CellGroups`: the parts of the mesh are the field ``cell_group``. Empty: there is one.
    jit_seconds : float
        Time spent compiling what the further fields need.
    """

    def __init__(
        self,
        path: Path,
        setup: Setup,
        resumed: bool = False,
        files: RunFiles | None = None,
        goals: Sequence[str] = (),
    ) -> None:
        problem, motion = setup.problem, setup.stepper.motion
        #: The time of load 1.
        self._duration = motion.duration if motion else 1.0
        constant = _dolfinx.function_space(problem.domain, 0, family="DG")
        energy = ["energy_density"] if problem.has_energy else []
        names_of_all = ["J", "min_J", *energy, "min_eigenvalue"]
        self._cellwise = {name: _dolfinx.function(constant, name) for name in names_of_all}
        groups: CellGroups | None = None
        if setup.mesh.has_parts or len(problem.regions) > 1:
            from fem_snh.runs.output.cell_groups import cell_groups

            groups = cell_groups(setup.mesh, problem.regions)
        self.group_names = groups.names if groups else []
        self._groups = [_dolfinx.DataArray(CELL_GROUP, groups.numbers)] if groups else []
        self._errors = {goal: _dolfinx.function(constant, error_field(goal)) for goal in goals}
        #: Whether the state at load 1 waits for the errors.
        self._waits = bool(goals)
        self._dofs = _dolfinx.node_dofs(constant)[:, 0]
        self._nodal, self._num_owned = [problem.u], _dolfinx.num_nodes(problem.V)[0]
        if problem.saddle_point:
            self._pressure = _dolfinx.function(problem.saddle_point.Q, "pressure")
            scalars = _dolfinx.function_space(problem.domain, problem.element.degree)
            self._nodal.append(_dolfinx.function(scalars, "pressure"))
        until = problem.load * self._duration if resumed else None
        self._series = _dolfinx.Series(problem.comm, path, until, files)
        self._obstacles: ObstacleSeries | None = None
        shapes = [s for t in problem.terms if isinstance(t, SurfaceTerm) for s in t.surfaces]
        if shapes:
            from fem_snh.runs.output.obstacle_series import ObstacleSeries

            self._obstacles = ObstacleSeries(
                path.with_name(OBSTACLES), problem.comm, shapes, until, files
            )
        self._skin: SkinSeries | None = None
        if problem.skin is not None:
            from fem_snh.runs.output.skin_series import SkinSeries

            self._skin = SkinSeries(path.with_name(SKIN), problem.V, problem.skin, until, files)
        self._requested: RequestedFields | None = None
        start = perf_counter()
        if setup.scene.fields:
            from fem_snh.runs.output.field_values import RequestedFields

            chosen = setup.scene.fields, setup.scene.fields_at
            self._requested = RequestedFields(problem, *chosen, motion.functions if motion else {})
        self.jit_seconds = perf_counter() - start

    def write(self, problem: Problem) -> None:
        """Append the problem's state at its load to each series that does not have it. Collective.

        A run that is killed may leave the state in some of the series.
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
        for name, function in self._cellwise.items():
            function.x.array[self._dofs] = values[name]
        if problem.saddle_point:
            self._pressure.x.array[:] = problem.saddle_point.pressure()
            self._nodal[1].interpolate(self._pressure)
        further = self._requested.arrays() if self._requested else ([], [])
        if self._series in lacking:
            functions = [*self._nodal, *self._cellwise.values(), *self._errors.values()]
            cells = [*self._groups, *further[0]]
            self._series.write(functions, time, cells, self._without_copies(further[1]))
        if self._skin in lacking:
            per_cell, nodes = ({array.name: array.values for array in found} for found in further)
            if problem.saddle_point:
                vector = _dolfinx.function(problem.V, "pressure")  # the skin needs its numbering
                vector.sub(0).interpolate(self._pressure)
                nodes["pressure"] = vector.x.array.reshape(-1, 3)[:, 0]
            u = problem.u.x.array.reshape(-1, 3)
            self._skin.write(u, time, {n: values[n] for n in self._cellwise} | per_cell, nodes)

    def write_errors(self, problem: Problem, indicators: Mapping[str, Array]) -> None:
        """Write the state with the errors of goals in each cell of this rank. Collective.

        Goals without indicators have zeros.
        """
        for goal, function in self._errors.items():
            function.x.array[self._dofs] = indicators.get(goal, 0.0)
        self._waits = False
        self.write(problem)

    def _without_copies(self, arrays: list[_dolfinx.DataArray]) -> list[_dolfinx.DataArray]:
        """Return arrays at the nodes, with zeros at ghosts where values are to be summed."""
        found = []
        for array in arrays:
            if array.name in SUMMED:
                values = array.values.copy()
                values[self._num_owned :] = 0.0
                array = array._replace(values=values)
            found.append(array)
        return found


def write_modes(path: Path, modes: VibrationModes, files: RunFiles | None = None) -> None:
    """Write the mode shapes to a .pvd file, at the times 1, 2, ... Collective.

    Each time has the mode shape ``mode`` [length] and the displacement about which the body
    vibrates. The mean square of ``mode`` over the mass is the square of ``Problem.length``.

    Parameters
    ----------
    path : Path
        The .pvd file.
    modes : VibrationModes
        The eigenfrequencies and mode shapes.
    files : RunFiles, optional
        The run's files.
    """
    problem = modes.problem
    series = _dolfinx.Series(problem.comm, path, files=files)
    for number in range(1, len(modes.shapes) + 1):
        series.write([problem.u, modes.function(number)], float(number))
