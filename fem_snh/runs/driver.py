"""Run a scene: set-up, load steps, output. ``fem_snh.run`` and ``fem-snh run`` call it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from fem_snh import scenes, solver
from fem_snh.cache import untimed
from fem_snh.errors import BadInput, on_every, on_root
from fem_snh.problem.free_motions import SupportsCheck
from fem_snh.processes import Interrupts
from fem_snh.records.run_record import Note
from fem_snh.runs.checkpoint import Checkpoint
from fem_snh.runs.folder import Folder, describe
from fem_snh.runs.notes import final_notes
from fem_snh.runs.progress import Progress
from fem_snh.runs.recorder import Recorder
from fem_snh.runs.result import Result
from fem_snh.runs.scene_options import scene_options
from fem_snh.runs.setup import Setup, set_up
from fem_snh.scenes._outputs import DEFAULT_DENSITY
from fem_snh.solver.options import unused_options

if TYPE_CHECKING:
    from fem_snh.accuracy.goal_errors import Estimate
    from fem_snh.problem.goals import Goal
    from fem_snh.runs.level_runs import Level

#: Seconds for which the other ranks continue after an interruption, so that rank 0 can write
#: run.json. It is longer than the second after which mpirun kills all ranks.
_DELAY = 5.0


def run(
    scene: str | Path | scenes.Scene | Callable[..., scenes.Scene],
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: bool = True,
    expected: str | None = None,
    note: Mapping[str, Any] | None = None,
    **overrides: Any,
) -> Result:
    """Solve a scene by load steps, or by time steps. Collective.

    A step that fails is rolled back and halved, down to 1/64 of the nominal step. If that fails
    too, the run ends with ``converged`` False; the steps before it are kept.

    Parameters
    ----------
    scene : str, Path, Scene or callable
        A scene's name, a .toml file, ``FILE.py:NAME``, a function that returns a Scene, or a
        `fem_snh.scenes.Scene`.
    out : str or Path, optional
        Folder for run.json, steps.csv, checkpoint.npz and fields.pvd, all written as steps end;
        modes.csv and modes.pvd if the scene requests modes. A folder that is not empty is an error
        without ``overwrite`` or ``resume``.
    overwrite : bool
        Replace the run in ``out``: the files with names that a run writes. Other files stay.
    resume : bool
        Continue the run in ``out`` from its last step, on any number of ranks; with
        ``accuracy.within`` from the level after the last finished level. The scene must be the
        same, except for the keys SOLVER_KEYS and OUTPUT_KEYS of ``fem_snh.runs.scene_options``.
    comm : MPI.Comm
        The communicator.
    progress : bool
        Print a line for each step on rank 0.
    expected : str, optional
        For a run that is meant to fail: the reason, e.g. "Smith et al. 2018 report that this
        energy fails here". It is printed before the first step.
    note : mapping, optional
        Further keys and values of run.json.
    **overrides
        As for `fem_snh.scenes.load`: material, E, nu, cells, element, hessian, globalization,
        steps, predictor, quadrature, petsc (a dict of PETSc options), and
        the parameters of the scene's function.

    Returns
    -------
    Result

    Raises
    ------
    BadInput
        On every rank, for bad input.
    Failed
        If memory is exhausted or PETSc reports an error.
    """
    start = perf_counter()
    if resume and (out is None or overwrite):
        raise BadInput("--resume: expected with --out DIR, and without --overwrite")
    # Files may differ from rank to rank: the scene, and the functions that it refers to.
    scene = on_every(comm, partial(scenes.load_to_run, scene, **overrides))
    printed = Progress(comm, progress, expected)
    solve: Callable[..., Result] = partial(_run, comm, printed=printed, note=note, start=start)
    if scene.within:
        from fem_snh.runs.level_runs import run_levels

        solve = partial(run_levels, comm, solve, printed, resume=resume)
    if out is None:
        return solve(scene)
    with closing(Folder(comm, out, scene.files.values(), overwrite, resume)) as folder:
        if resume and not scene.within:
            solve = partial(solve, stored=Checkpoint.read(folder, scene))
        result = solve(scene, folder=folder)
    comm.barrier()  # the files are complete before any rank returns
    return result


def _run(
    comm: MPI.Comm,
    scene: scenes.Scene,
    *,
    printed: Progress,
    note: Mapping[str, Any] | None,
    start: float,
    folder: Folder | None = None,
    stored: Checkpoint | None = None,
    level: Level | None = None,
    alone: bool = False,
) -> Result:
    """Solve a scene, from the checkpoint ``stored`` or the previous level if given. Collective.

    A coarser run measures the estimates of its errors, unless it is to be ``alone``.
    """
    with solver.petsc_failures(), scene_options(scene) as given:
        setup = set_up(
            comm, scene, stored is not None, *((level.mesh, level.stiffer) if level else ())
        )
        if level:
            level.begin(setup)
        about = describe(setup)
        supports = SupportsCheck(setup.problem)
        supports.check()
        unlocked = Note("folder", folder.note) if folder and folder.note else None
        if notes := [*filter(None, (unlocked, setup.note)), *supports.notes]:
            about["notes"] = [*about.get("notes", ()), *(note.record() for note in notes)]
        about |= note or {}
        if level:
            about["accuracy"] = level.levels.record()
        printed.start(about)
        goals: list[Goal] = []
        if wanted := scene.modes:
            from fem_snh.problem import modes

            modes.check(setup.problem, wanted.count)
        if scene.estimates_error:
            from fem_snh.runs.scene_goals import scene_goals

            goals = scene_goals(setup)
        if stored and folder:
            missing = stored.missing(scene, goals)
            stored.restore(setup.stepper)
            printed.resumed(stored.load, stored.finished, missing, scene.duration)
            if stored.finished and not missing:
                setup.destroy()
                return setup.result(stored.record, folder.path)
        recorder = Recorder(about, setup, folder, start, stored and stored.record, goals)
        if folder and (scene.obstacle or scene.bone or scene.rigid):
            from fem_snh.runs.bone_records import copy_surfaces

            on_root(comm, copy_surfaces, scene, folder)
        again = partial(_run, comm, printed=Progress(comm, False), note=None, start=start)
        estimate = _solve(setup, recorder, printed, goals, level, None if alone else again)
        if level:
            level.end(recorder.record, estimate)
        status = "converged" if setup.stepper.done else setup.stepper.failure_message()
        with untimed(setup.problem):
            recorder.add_notes(final_notes(setup, recorder.record["steps"]))
        recorder.add_notes(unused_options(solver.PREFIX + name for name in given))
        recorder.save(status)
        path = folder.final if folder else None
        printed.end(recorder.record, path)
        setup.destroy()
    return setup.result(recorder.record, path, estimate)


def _solve(
    setup: Setup,
    recorder: Recorder,
    printed: Progress,
    goals: Sequence[Goal],
    level: Level | None,
    again: Callable[..., Result] | None,
) -> Estimate | None:
    """Solve all load steps, then compute modes and errors; record each result. Collective.

    Returns the errors; None if there are no goals or a step failed. The levels before measure them,
    or a run of the scene ``again`` on a coarser mesh.
    """
    estimate = None
    with _interrupts(setup) as interrupts, recorder, solver.petsc_failures():
        recorder.save("running", state=True)
        for step in setup.stepper:
            printed.step(step)
            with interrupts.postponed():
                recorder.add_step(step)
        if (wanted := setup.scene.modes) and setup.stepper.done:
            from fem_snh.problem.modes import lowest

            found = lowest(setup.problem, wanted.density or DEFAULT_DENSITY, wanted.count)
            with interrupts.postponed():
                recorder.add_modes(found)
        if goals and setup.stepper.done:
            from fem_snh.runs.estimates import estimate_errors

            with untimed(setup.problem):
                estimate = estimate_errors(setup, goals, recorder, printed, level, again)
            recorder.add_estimate(estimate)
            if setup.scene.within is None:  # the levels have rows of their own
                printed.estimated(estimate)
    return estimate


def _interrupts(setup: Setup) -> Interrupts:
    """Return the signal handlers, which give rank 0 the time to write run.json."""
    # Python handles signals when PETSc calls it, so it needs a monitor. All ranks have one: with a
    # monitor, a solver may compute a norm, which is collective.
    setup.snes.getKSP().setMonitor(lambda *_: None)
    return Interrupts(_DELAY if setup.problem.comm.rank else 0.0)
