"""Run a scene to a required accuracy: levels of finer and finer meshes, each a run of the driver.

The load steps are followed on the first mesh. A finer one starts from the end state of the level
before it, interpolated, in one step to the full load; on the last one they are followed again if
the scene asks for the path. A motion, or a path on which the end depends, as with friction, is
followed again on each level, with shorter steps where their error is not small.
`fem_snh.accuracy.levels` decides when the levels end and how fine the next is.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import ceil
from time import perf_counter
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx, scenes
from fem_snh.accuracy.estimate import largest_error
from fem_snh.accuracy.goal_errors import Estimate
from fem_snh.accuracy.levels import LevelRow, Levels
from fem_snh.accuracy.lift import available_memory
from fem_snh.accuracy.target_volumes import target_volumes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.mesh import simplices
from fem_snh.mesh.bisection import MOST_CELLS, bisect_times
from fem_snh.mesh.gmsh_input import MeshData
from fem_snh.mesh.mesh import Mesh, cell_volumes, distribute, gather
from fem_snh.mesh.round_faces import round_faces
from fem_snh.mesh.size_field import size_field
from fem_snh.notes import NOTES_ON_PATH
from fem_snh.problem.problem import Problem
from fem_snh.problem.transfer import transfer_state
from fem_snh.runs.exact_bodies import (
    cells_of,
    has_exact_cells,
    is_exact,
    may_have_any_sizes,
)
from fem_snh.runs.first_level import HALVES, first_scene, raised_element
from fem_snh.runs.first_mesh import fine_at, stress_probes
from fem_snh.runs.result import Result
from fem_snh.runs.scene_mesh import mesh_again
from fem_snh.solver.options import OPTIONS

if TYPE_CHECKING:
    from fem_snh.runs.folder import Folder
    from fem_snh.runs.progress import Progress
    from fem_snh.runs.setup import Setup

Array = npt.NDArray[Any]

#: The option of Newton's tolerance.
_TOLERANCE = "snes_scaled_tol"
#: Levels without an estimate after which the run ends: the first meshes may be too coarse.
_MOST_WITHOUT = 3


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
        Its mesh; None: that of the scene.
    before : Problem or None
        The problem of the level before it, at its solution.
    fineness : float
        The cells along an edge; 0: the root of the number of cells.
    stiffer : float
        The stiffness of its penalties over that of the scene's.
    notes : list of dict
        The notes on the path to the state that it starts from.
    volumes : (owned cells,) array
        The volumes of its cells [length^dim].
    row : LevelRow or None
        Its discretisation, from `begin` on.
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

    @property
    def given(self) -> tuple[Mesh | None, float]:
        """The mesh, and the factor of the penalties' stiffness."""
        return self.mesh, self.stiffer

    def begin(self, setup: Setup) -> None:
        """Take the end state of the level before. Collective."""
        problem = setup.problem
        self.mesh, self.volumes = setup.mesh, cell_volumes(problem.domain)
        cells, element = problem.num_cells, problem.element
        self.row = LevelRow(element.name, element.degree, cells, problem.dofs)
        self.row.fineness = self.fineness or cells ** (1 / self.levels.dim)
        if self.before is not None:
            problem.set_load(1.0)
            transfer_state(self.before, problem)
            problem.prescribe(problem.x)
            problem.set_load(0.0)
            self.before = None

    def located(self, found: Estimate, names: Sequence[str], locally: bool) -> Collection[str]:
        """Return the goals of which the next level, or a line, needs the errors in the cells.

        Parameters
        ----------
        found : Estimate
            The errors.
        names : sequence of str
            The goals whose errors can be distributed to the cells.
        locally : bool
            Whether the mesh is refined where they are.
        """
        assert self.row is not None
        beyond = [name for name in self.levels.beyond(self.row, found) if name in names]
        return beyond if locally or not beyond else largest_error(found, beyond)

    def end(self, record: dict[str, Any], estimate: Estimate | None) -> None:
        """Add the level to the levels, and them to the record of the run."""
        in_time = "time" in record["steps"][-1]
        followed = in_time or (estimate is not None and estimate.again > 0)
        rows = record["steps"] if followed else record["steps"][-1:]
        seconds = sum(row["seconds"] for row in rows)
        memory = 0.0
        if estimate:
            seconds += estimate.seconds - estimate.jit
            memory = estimate.memory
        row = self.row
        assert row is not None
        row.seconds, row.memory = seconds, memory
        row.elapsed, row.steps = perf_counter() - self.start, len(rows) if followed else 0
        row.kind = "time" if in_time else "load"
        self.levels.add(row, estimate)
        record["accuracy"] = self.levels.record()
        if self.notes:
            record.setdefault("notes", []).extend(self.notes)


#: ``solve(scene, folder=folder, level=level)`` is a run of the driver.
Solve = Callable[..., Result]


def run_levels(
    comm: MPI.Comm,
    solve: Solve,
    printed: Progress,
    scene: scenes.Scene,
    folder: Folder | None = None,
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
        The folder of the output, which has that of the last level.

    Returns
    -------
    Result
        That of the last level. ``record["accuracy"]`` has all of them.
    """
    wanted = scene.accuracy
    assert wanted is not None and wanted.within is not None
    limits = {key: getattr(wanted, key) for key in ("max_time", "max_memory", "max_dofs")}
    own_cells, scene = scene.cells, first_scene(scene, printed)
    refine = _refinement(scene)
    first = None
    if probes := stress_probes(scene):
        if is_refined_locally(scene):
            again = partial(_mesh_like, scene) if refine is _remeshed else None
            first = fine_at(comm, scene, probes, again)
        elif refine is _more_cells:
            scene = scene.model_copy(update={"cells": own_cells})
    dim = kinematics_of(scene.kinematics).dim
    least = 2 if isinstance(scene.mesh, scenes.Lattice) else 1
    levels = Levels(wanted.within, limits, dim, bool(wanted.goals), least)
    start, current, stiffness = perf_counter(), scene, 1.0
    by_cells = refine is _more_cells

    def next_level(mesh: Mesh | None = None, before: Result | None = None) -> Level:
        fineness = float(current.cells or 0) if by_cells else 0.0
        if before is None:
            return Level(levels, start, mesh, None, fineness, stiffness)
        notes = _notes_on_path(before, len(levels.rows))
        return Level(levels, start, mesh, before.problem, fineness, stiffness, notes)

    def follow_path() -> tuple[scenes.Scene, Level, Result]:
        """Solve the last level again, by the scene's own load steps."""
        levels.rows.pop()
        again, same = current.model_copy(update=_path(scene)), next_level(level.mesh)
        return again, same, solve(again, folder=folder, level=same)

    level = next_level(first)
    while True:
        started = level.before is not None
        result = solve(current, folder=folder, level=level)
        if not result.converged and started:
            printed.line("the path is followed again: no equilibrium was found near the last state")
            current, level, result = follow_path()
        thin = [n["text"] for n in result.notes if n["kind"] == "supports" and "force" in n]
        levels.rows[-1].gives_way = thin[0] if thin else ""
        printed.level(levels.lines())
        if not result.converged or levels.reached:
            break
        without = [not row.goals for row in levels.rows[-_MOST_WITHOUT:]]
        hopeless = result.estimate is not None and result.estimate.on_no_mesh
        if hopeless or (len(without) == _MOST_WITHOUT and all(without)):
            levels.limit = f"no estimate of the error: {levels.rows[-1].reason}"
            break
        if thin and levels.estimates_suffice:
            levels.limit = thin[0]
            break
        if thin and not levels.decrease:
            levels.limit = f"the errors do not decrease: {thin[0]}"
            break
        refinement = 1.0 if levels.mesh_suffices else levels.refinement()
        shorter = levels.shorter_steps()
        stiffer = levels.stiffer_penalties(refinement, shorter)
        tighter = levels.tighter_tolerance()
        if max(refinement, shorter, stiffer, tighter) == 1:  # no part is what the bound is of
            refinement = levels.refinement()
        if refine is _higher_degree and refinement > 1:
            if raised_element(current) == current.element:
                levels.limit = f"cells of a file have element = '{current.element}' at most"
                break
            forecast = levels.forecast_of_degree(result.estimate.dofs if result.estimate else 0)
        else:
            forecast = levels.forecast(refinement, shorter)
        # Each rank has measured seconds of its own: all decide by those of rank 0.
        elapsed, forecast = comm.bcast((perf_counter() - start, forecast))
        if limit := levels.exceeds(forecast, elapsed, available_memory(comm)):
            levels.limit = limit
            break
        printed.line(f"level {len(levels.rows) + 1}: {forecast}")
        mesh = level.mesh
        if refinement > 1:
            current, mesh = refine(comm, current, level, result.estimate, refinement)
        if stiffer > 1:
            printed.line(f"penalties are {stiffer:.2g} times stiffer")
            stiffness *= stiffer
        if tighter > 1:
            given = current.petsc.get(_TOLERANCE)
            tolerance = float(OPTIONS[_TOLERANCE].default if given is None else given) / tighter
            printed.line(f"Newton's tolerance is {tolerance:.2g}")
            petsc = current.petsc | {_TOLERANCE: tolerance}
            current = current.model_copy(update={"petsc": petsc})
        if current.time:
            steps = HALVES * ceil(current.time.steps * shorter / HALVES)
            time = current.time.model_copy(update={"steps": steps})
            current, known = current.model_copy(update={"time": time}), False
        elif levels.rows[-1].steps:
            steps = ceil(current.steps * shorter)
            current, known = current.model_copy(update={"steps": steps}), False
        else:  # without goals the state may be none to start from
            known = bool(levels.rows[-1].goals)
            current = current.model_copy(update=_ONE_STEP if known else _path(scene))
        level = next_level(mesh, result if known else None)
    if wanted.path and levels.reached and current.steps < scene.steps:
        printed.line("the load steps are followed on the last mesh")
        current, level, result = follow_path()
        printed.level(levels.lines())
    result.record["accuracy"] = levels.record()
    printed.reached(result.record["accuracy"])
    return result


def _notes_on_path(before: Result, number: int) -> list[dict[str, Any]]:
    """Return the notes on the path to the end of a level; their steps are not those of the next."""
    found = []
    for note in before.notes:
        if note["kind"] in NOTES_ON_PATH:
            of_step = note["step"] is not None
            text = f"level {number}: {note['text']}" if of_step else note["text"]
            found.append(note | {"step": None, "text": text})
    return found


#: What a level that starts from the state before has in place of the scene's own.
_ONE_STEP = {"steps": 1, "predictor": "none", "nu_continuation": [], "start": None}


def _path(scene: scenes.Scene) -> dict[str, Any]:
    return {key: getattr(scene, key) for key in _ONE_STEP}


Refine = Callable[
    [MPI.Comm, scenes.Scene, Level, "Estimate | None", float], tuple[scenes.Scene, Mesh | None]
]


#: The volumes of cells that a level wants, by the factor of the number of cells.
Target = Callable[[float], Array]


def _refinement(scene: scenes.Scene) -> Refine:
    """Return how the mesh of a scene is refined; hexahedra of a file get a higher degree."""
    simplices = ELEMENTS[scene.element].cell == "tetrahedron"
    if isinstance(scene.mesh, scenes.Lattice):
        return _smaller_lattice
    if is_exact(scene) and not (simplices and has_exact_cells(scene)):
        # On a path the errors are not distributed to the cells.
        sizes = simplices and not scene.time and may_have_any_sizes(scene)
        return _remeshed if sizes else _more_cells
    if simplices:
        return _bisected
    return _higher_degree


def is_refined_locally(scene: scenes.Scene) -> bool:
    """Return whether a scene's mesh is refined where the errors are."""
    return _refinement(scene) in (_bisected, _remeshed)


def _more_cells(
    comm: MPI.Comm, scene: scenes.Scene, level: Level, estimate: Estimate | None, finer: float
) -> tuple[scenes.Scene, Mesh | None]:
    assert scene.cells is not None
    cells = cells_of(scene, max(scene.cells + 1, scene.cells * finer))
    return scene.model_copy(update={"cells": cells}), None


def _smaller_lattice(
    comm: MPI.Comm, scene: scenes.Scene, level: Level, estimate: Estimate | None, finer: float
) -> tuple[scenes.Scene, Mesh | None]:
    assert isinstance(scene.mesh, scenes.Lattice)
    cell = scene.mesh.cell / finer
    return scene.model_copy(update={"mesh": scene.mesh.model_copy(update={"cell": cell})}), None


def _higher_degree(
    comm: MPI.Comm, scene: scenes.Scene, level: Level, estimate: Estimate | None, finer: float
) -> tuple[scenes.Scene, Mesh | None]:
    return scene.model_copy(update={"element": raised_element(scene)}), level.mesh


def _bisected(
    comm: MPI.Comm, scene: scenes.Scene, level: Level, estimate: Estimate | None, finer: float
) -> tuple[scenes.Scene, Mesh | None]:
    def bisected(data: MeshData, target: Target, wanted: float) -> MeshData:
        return bisect_times(data, target, wanted, MOST_CELLS)

    mesh = _with_target(comm, scene, level, estimate, finer, bisected)
    assert level.mesh is not None
    revolved = kinematics_of(scene.kinematics).revolved
    faces = level.mesh.round_faces or round_faces(level.mesh.domain, revolved)
    return scene, replace(mesh, round_faces=faces)


def _remeshed(
    comm: MPI.Comm, scene: scenes.Scene, level: Level, estimate: Estimate | None, finer: float
) -> tuple[scenes.Scene, Mesh | None]:
    def remeshed(data: MeshData, target: Target, wanted: float) -> MeshData:
        return _mesh_like(scene, data, target(wanted))

    return scene, _with_target(comm, scene, level, estimate, finer, remeshed)


def _mesh_like(scene: scenes.Scene, data: MeshData, volumes: Array | None = None) -> MeshData:
    """Mesh an exact body again, with cells of other volumes or of those of a mesh. On rank 0."""
    cells = data.cells[:, : data.x.shape[1] + 1]
    volumes = simplices.volumes(data.x[cells]) if volumes is None else volumes
    return mesh_again(scene, data.cell, size_field(cells, data.x, volumes))


def _with_target(
    comm: MPI.Comm,
    scene: scenes.Scene,
    level: Level,
    estimate: Estimate | None,
    finer: float,
    make: Callable[[MeshData, Target, float], MeshData],
) -> Mesh:
    """Return the mesh that a function makes on rank 0 from the last one. Collective."""
    assert level.mesh is not None
    owned = len(level.volumes)
    weights: Array = np.zeros(owned)
    if estimate is not None and level.levels.rows[-1].goals:
        weights = level.levels.cell_weights(estimate, owned)
    data = gather(level.mesh)
    rows = comm.gather((_dolfinx.input_cells(level.mesh.domain)[:owned], level.volumes, weights))
    degree, dim = ELEMENTS[scene.element].degree, level.mesh.dim

    def make_on_root() -> MeshData:
        volumes, sizes = np.empty((2, len(data.cells)))
        for numbers, *values in rows:
            volumes[numbers], sizes[numbers] = values

        def target(growth: float) -> Array:
            return target_volumes(volumes, sizes, degree, growth, dim)

        return make(data, target, finer**dim)

    return distribute(comm, "the refined mesh", make_on_root)
