"""Run a scene to a required accuracy: levels of finer and finer meshes, each a run of the driver.

The first level takes the load steps. A finer level starts from the interpolated end state of the
level before it, and takes one step to the full load. The last level takes the load steps again if
the scene asks for the path. If the end depends on the path, as with friction, or if the scene is
dynamic, each level takes all steps, with shorter steps where their error is not small.
`fem_snh.accuracy.levels` decides when the levels end and how fine the next level is.

The output folder holds the last finished level. The next level is written into a subfolder, and
replaces the level in the folder when it is complete. A killed run continues after the last finished
level.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from math import ceil
from time import perf_counter
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import scenes
from fem_snh.accuracy.goal_errors import Estimate
from fem_snh.accuracy.levels import LevelChanges, LevelRow, Levels
from fem_snh.accuracy.lift import available_memory
from fem_snh.accuracy.path_errors import HALVES
from fem_snh.accuracy.refinement import Lineage, left_by_parts, unmeasured
from fem_snh.arrays import Array
from fem_snh.assembly.elements import element
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.assembly.unknowns import num_unknowns
from fem_snh.errors import BadInput, OutOfTime, on_root
from fem_snh.mesh.mesh import Mesh, cell_volumes, of_input_cells
from fem_snh.problem.problem import Problem
from fem_snh.problem.transfer import transfer_state
from fem_snh.records.run_record import NOTES_ON_PATH
from fem_snh.runs.checkpoint import Checkpoint
from fem_snh.runs.level_meshes import (
    Refined,
    first_scene,
    more_cells,
    refinement_of,
    smaller_lattice,
)
from fem_snh.runs.result import Result
from fem_snh.runs.setup import Setup, set_up
from fem_snh.runs.stored_levels import StoredLevels, read_levels, write_levels
from fem_snh.solver import petsc_failures

if TYPE_CHECKING:
    from fem_snh.runs.folder import Folder
    from fem_snh.runs.progress import Progress


@dataclass
class Level:
    """One level: what the driver starts it from, and what it reports.

    Attributes
    ----------
    levels : Levels
        The levels so far, to which this one is added.
    start : float
        The value of `time.perf_counter` at the start of the first level.
    mesh : Mesh or None
        The level's mesh; None until `begin`: the mesh of the scene.
    before : Problem or None
        The problem of the level before, at its solution; None after `begin`.
    fineness : float
        The cells along an edge; 0: the root, 1/dim, of the number of cells.
    stiffer : float
        The factor by which penalties are stiffer than the scene's.
    notes : list of dict
        The notes on the path to the state from which the level starts.
    volumes : (owned cells,) array
        The volumes of this rank's cells [length^dim].
    row : LevelRow or None
        The level's discretisation, from `begin` on; its errors, from `end` on.
    lineage : Lineage or None
        On rank 0, where the cells of `mesh` come from, if those of the level before were bisected.
    ends_in_time : bool
        Whether it is given up where ``max_time`` is exceeded by far.
    """

    levels: Levels
    start: float
    mesh: Mesh | None = None
    before: Problem | None = None
    fineness: float = 0.0
    stiffer: float = 1.0
    notes: list[dict[str, Any]] = field(default_factory=list)
    volumes: Array = field(default_factory=lambda: np.empty(0))
    row: LevelRow | None = None
    lineage: Lineage | None = None
    ends_in_time: bool = False

    def begin(self, setup: Setup) -> None:
        """Set `mesh`, `volumes`, `row`, and the problem's state to that of `before`. Collective."""
        problem = setup.problem
        if self.ends_in_time:
            setup.snes.setUpdate(self._check_time)
        self.mesh, self.volumes = setup.mesh, cell_volumes(problem.domain)
        cells, element = problem.num_cells, problem.element
        self.row = LevelRow(element.name, element.degree, cells, problem.dofs)
        self.row.fineness = self.fineness or cells ** (1 / self.levels.dim)
        if self.lineage is not None:  # on rank 0
            self.row.left = left_by_parts(self.lineage, element.degree, self.levels.dim)
        self.row.left = problem.comm.bcast(self.row.left)
        if self.before is not None:
            problem.set_load(1.0)
            transfer_state(self.before, problem)
            problem.prescribe(problem.x)
            problem.set_load(0.0)
            self.before = None

    def _check_time(self, snes: PETSc.SNES, its: int) -> None:
        """Raise OutOfTime if the levels take much longer than they may. Collective."""
        limit = self.levels.overrun(perf_counter() - self.start)
        if limit := snes.comm.tompi4py().bcast(limit):
            raise OutOfTime(limit)

    def measure(self, estimate: Estimate) -> None:
        """Add the bounds that the levels so far measure to the estimate of this one."""
        assert self.row is not None
        self.levels.measure(self.row, estimate, self._unmeasured(estimate))

    def _unmeasured(self, estimate: Estimate) -> dict[str, float]:
        """Return the errors of which the effectivity says nothing, by goal. Collective."""
        assert self.mesh is not None
        domain, found = self.mesh.domain, dict[str, float]()
        for name, indicators in estimate.indicators.items():
            errors = of_input_cells(domain, np.abs(indicators))
            if self.lineage is not None and name in self.lineage.of_goals:  # on rank 0
                parents, before = self.lineage.parents, self.lineage.of_goals[name]
                error = abs(estimate.goals[name].of_mesh)
                found[name] = unmeasured(errors, error, parents, before)
        return domain.comm.bcast(found)

    def end(self, record: dict[str, Any], estimate: Estimate | None) -> None:
        """Add the level's row to `levels`; put their record and `notes` into the run's record."""
        in_time = "time" in record["steps"][-1]
        followed = in_time or (estimate is not None and estimate.again > 0)
        whole = followed or (estimate is not None and estimate.loads)
        rows = record["steps"] if whole else record["steps"][-1:]
        row = self.row
        assert row is not None
        row.seconds = sum(step["seconds"] for step in rows)
        if estimate:
            row.seconds += estimate.seconds - estimate.jit
        row.elapsed = perf_counter() - self.start
        row.steps = sum(step["converged"] for step in rows) if followed else 0
        row.kind = "time" if in_time else "load"
        self.levels.add(row, estimate)
        if not row.goals and not whole:  # the next level follows the load steps again
            row.seconds += sum(step["seconds"] for step in record["steps"][:-1])
        record["accuracy"] = self.levels.record()
        if self.notes:
            record.setdefault("notes", []).extend(self.notes)

    def cell_weights(self, of_all: bool = False) -> Array:
        """Return the errors of this rank's cells that are to be reduced, or ``of_all`` goals."""
        return self.levels.cell_weights(len(self.volumes), of_all)


#: A run of the driver: ``solve(scene, folder=folder, level=level)``.
Solve = Callable[..., Result]


def run_levels(
    comm: MPI.Comm,
    solve: Solve,
    printed: Progress,
    scene: scenes.Scene,
    folder: Folder | None = None,
    resume: bool = False,
) -> Result:
    """Solve a scene on finer and finer meshes until its goals are within the request. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    solve : callable
        See `Solve`.
    printed : Progress
        The printer.
    scene : Scene
        The scene, whose ``accuracy.within`` is set.
    folder : Folder, optional
        The folder of the output, which holds the last finished level.
    resume : bool, optional
        Whether the levels in the folder are continued.

    Returns
    -------
    Result
        The result of the last level. ``record["accuracy"]`` describes all levels.
    """
    stored = read_levels(folder, scene) if resume and folder else None
    if resume and stored is None:
        printed.line("no level was finished: the first one starts again")
    with closing(_LevelRuns(comm, solve, printed, scene, folder, stored)) as runs:
        return runs.run()


class _LevelRuns:
    """The runs of the levels of a scene, one after the other. Collective.

    Parameters are those of `run_levels`, and the levels that are continued.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        solve: Solve,
        printed: Progress,
        scene: scenes.Scene,
        folder: Folder | None,
        stored: StoredLevels | None,
    ) -> None:
        wanted = scene.accuracy
        assert wanted is not None and wanted.within is not None
        self._comm, self._solve, self._printed, self._wanted = comm, solve, printed, wanted
        self._asked, self._folder = scene, folder
        first = first_scene(scene, printed)
        self._refine = refinement_of(first)
        limits = {key: getattr(wanted, key) for key in ("max_time", "max_memory", "max_dofs")}
        dim = kinematics_of(first.kinematics).dim
        self._levels = Levels(wanted.within, limits, dim, bool(wanted.goals))
        #: The scene of the first level; the present level's changes of it; the resulting scene.
        self._first, self._changes, self._scene = first, dict[str, Any](), first
        self._start, self._stored = perf_counter(), stored
        self._level = self._create_level(None)
        #: The record of the last finished level.
        self._finished: dict[str, Any] = {}
        #: The folder of the next level, until the level replaces the last finished one.
        self._next: Folder | None = None

    def run(self) -> Result:
        """Solve levels until the goals are within the request, or a limit is reached."""
        comm, levels, printed = self._comm, self._levels, self._printed
        result = self._restore(self._stored) if self._stored else self._solve_level()
        while result.converged and not levels.reached:
            levels.limit = levels.futility
            if levels.limit:
                break
            changes, refined = levels.changes(), None
            try:
                if changes.refinement > 1:
                    refined = self._refine(comm, self._scene, self._level, changes.refinement)
                levels.limit = self._announce(changes, refined)
            except BadInput as reason:
                levels.limit = str(reason)
            if levels.limit:
                break
            self._prepare_next(changes, result, refined)
            try:
                result = self._solve_level()
            except OutOfTime as limit:
                levels.limit = f"level {len(levels.rows) + 1}: {limit}"
                break
        if self._wanted.path and levels.reached and self._scene.steps < self._first.steps:
            printed.line("the load steps are followed on the last mesh")
            result = self._end_level(self._follow_path(ends_in_time=False))
        if not result.converged and not levels.limit:
            levels.limit = f"level {len(levels.rows)}: {result.status}"
        result.record["accuracy"] = levels.record()
        if self._finished and self._folder:
            self._finished["accuracy"] |= {"limit": levels.limit or None}
            on_root(self._comm, self._folder.write, self._finished)
        printed.reached(result.record["accuracy"], self._asked.duration)
        return result

    def close(self) -> None:
        """Release the folder of the next level."""
        if self._next:
            self._next.close()

    def _create_level(self, mesh: Mesh | None, before: Result | None = None) -> Level:
        """Return a level of the present scene, from the state of the level before if given."""
        level = Level(self._levels, self._start, mesh, stiffer=self._changes.get("stiffer", 1.0))
        if self._refine is more_cells:
            level.fineness = float(self._scene.cells or 0)
        if before is not None:
            level.before = before.problem
            level.notes = _notes_on_path(before, len(self._levels.rows))
        return level

    def _solve_level(self) -> Result:
        """Solve the present level, store it and print its goals."""
        started = self._level.before is not None
        result = self._solve_aside()
        if not result.converged and started:
            self._printed.line(
                "the path is followed again: no equilibrium was found near the last state"
            )
            result = self._follow_path(self._level.ends_in_time)
        return self._end_level(result)

    def _solve_aside(self) -> Result:
        """Solve the present level; its files are beside those of the last finished level."""
        if self._folder and self._finished and not self._next:
            self._next = self._folder.next_level()
        return self._solve(self._scene, level=self._level, folder=self._next or self._folder)

    def _end_level(self, result: Result) -> Result:
        """Print the present level's goals; if it converged, replace the last finished level."""
        levels = self._levels
        row, last = levels.rows[-1], len(result.steps) - 1
        for note in result.notes:
            if note["kind"] == "supports" and "force" in note:
                row.gives_way = note["text"]
            if note["kind"] == "inverted" and note["step"] == last:
                row.estimate.left_out.append(f"finer meshes may have another state: {note['text']}")
        self._printed.level(levels.lines())
        if result.converged:
            self._finished = result.record | {"accuracy": levels.record()}
            if self._folder:
                self._store(self._folder, result.problem.domain)
        return result

    def _store(self, folder: Folder, domain: Any) -> None:
        """Write the record and levels.npz of the present level; replace the last finished level."""
        aside = self._next or folder
        mesh = None if self._refine in (more_cells, smaller_lattice) else self._level.mesh
        on_root(self._comm, aside.write, self._finished)
        lineage = self._level.lineage
        write_levels(aside, self._asked, self._levels, self._changes, domain, mesh, lineage)
        if self._next:
            folder.take(self._next)
            self._next = None

    def _restore(self, stored: StoredLevels) -> Result:
        """Set levels and state to those of the last finished level, and return its result."""
        assert self._folder
        levels = self._levels
        levels.rows = stored.rows
        last = levels.rows[-1]
        self._start -= last.elapsed
        self._change(stored.changes)
        self._level = self._create_level(stored.mesh)
        self._level.lineage = stored.lineage
        with petsc_failures():
            setup = set_up(self._comm, self._scene, True, self._level.mesh, self._level.stiffer)
            self._level.begin(setup)
            stored.restore_errors(last, setup.mesh.domain)
            checkpoint = Checkpoint.read(self._folder, self._scene)
            checkpoint.restore(setup.stepper)
            setup.destroy()
        self._finished = checkpoint.record
        self._printed.line(f"resumed after level {len(levels.rows)}")
        self._printed.level(levels.lines())
        return setup.result(checkpoint.record, self._folder.path, last.estimate)

    def _follow_path(self, ends_in_time: bool) -> Result:
        """Solve the present level again, by the scene's own load steps."""
        self._levels.rows.pop()
        lineage = self._level.lineage
        self._level = self._create_level(self._level.mesh)
        self._level.lineage, self._level.ends_in_time = lineage, ends_in_time
        self._change({"steps": self._first.steps, "starts_there": False})
        return self._solve_aside()

    def _change(self, changes: Mapping[str, Any]) -> None:
        """Add changes of the first level's scene, and set the present scene."""
        self._changes = {**self._changes, **changes}
        self._scene = _with_changes(self._first, self._changes)

    def _announce(self, changes: LevelChanges, refined: Refined | None) -> str:
        """Print what the next level will cost; return why it is not solved, "" if it is."""
        levels = self._levels
        mesh = refined.mesh if refined else None
        cells = mesh.num_cells if mesh else 0
        dofs = 0
        if refined and mesh:
            name = refined.changes.get("element", self._scene.element)
            kinematics = kinematics_of(self._scene.kinematics)
            dofs = num_unknowns(mesh.domain, element(name, kinematics=kinematics))
        forecast = levels.forecast(changes.refinement, changes.shorter, dofs, cells)
        # Each rank has measured seconds of its own: all decide by those of rank 0.
        elapsed, forecast = self._comm.bcast((perf_counter() - self._start, forecast))
        limit = levels.exceeds(forecast, elapsed, available_memory(self._comm))
        if 0 < dofs <= levels.rows[-1].dofs:
            limit = "no smaller cells were made"
        if not limit:
            self._printed.line(f"level {len(levels.rows) + 1}: {forecast}")
        return limit

    def _prepare_next(self, changes: LevelChanges, result: Result, refined: Refined | None) -> None:
        """Set the next level and its scene, by ``changes`` and the ``refined`` keys and mesh."""
        scene, level, printed = self._scene, self._level, self._printed
        refined = refined or Refined({}, level.mesh, level.lineage)
        new = refined.changes
        last = self._levels.rows[-1]
        if changes.stiffer > 1:
            printed.line(f"penalties are {changes.stiffer:.2g} times stiffer")
            new["stiffer"] = level.stiffer * changes.stiffer
        starts_there = False
        if scene.time:
            new["time_steps"] = HALVES * ceil(scene.time.steps * changes.shorter / HALVES)
        elif last.steps:
            new["steps"] = ceil(scene.steps * changes.shorter)
        else:  # without goals the state may be no start; goals at loads need the path
            starts_there = bool(last.goals) and not last.estimate.loads
            new |= {"steps": self._first.steps, "starts_there": starts_there}
        self._change(new)
        self._level = self._create_level(refined.mesh, result if starts_there else None)
        self._level.lineage, self._level.ends_in_time = refined.lineage, True


def _notes_on_path(before: Result, number: int) -> list[dict[str, Any]]:
    """Return the notes on the path to the end of a level, without ``step``, for the next level."""
    found = []
    for note in before.notes:
        if note["kind"] in NOTES_ON_PATH:
            of_step = note["step"] is not None
            text = f"level {number}: {note['text']}" if of_step else note["text"]
            found.append(note | {"step": None, "text": text})
    return found


#: Values of the scene's keys in a level that starts from the state of the level before.
_ONE_STEP = {"steps": 1, "predictor": "none", "nu_continuation": [], "start": None}


def _with_changes(first: scenes.Scene, changes: Mapping[str, Any]) -> scenes.Scene:
    """Return the scene of a level: the first level's scene with ``changes``."""
    update = {key: changes[key] for key in ("cells", "element", "steps") if key in changes}
    if first.time and "time_steps" in changes:
        update["time"] = first.time.model_copy(update={"steps": changes["time_steps"]})
    if isinstance(first.mesh, scenes.Lattice) and "cell" in changes:
        update["mesh"] = first.mesh.model_copy(update={"cell": changes["cell"]})
    if changes.get("starts_there"):
        update |= _ONE_STEP
    return first.model_copy(update=update)
