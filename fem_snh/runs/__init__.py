"""A scene and its options in, a `Result` out: load stepping, output, progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, process_time
from typing import Any
from warnings import catch_warnings

from mpi4py import MPI
from petsc4py import PETSc

from fem_snh import scenes, solver
from fem_snh._petsc import default_options, option_used
from fem_snh.errors import BadInput, RenamedKey
from fem_snh.fem import elements, modes
from fem_snh.fem import mesh as meshes
from fem_snh.fem.initial_state import set_initial_state
from fem_snh.fem.probes import Probes
from fem_snh.fem.problem import Problem
from fem_snh.kernels.pointwise import Material, material
from fem_snh.linalg import multigrid
from fem_snh.runs.checkpoint import Checkpoint, Writer
from fem_snh.runs.folder import Folder, describe
from fem_snh.runs.interrupts import Interrupts
from fem_snh.runs.poisson_continuation import PoissonContinuation
from fem_snh.runs.progress import Progress
from fem_snh.runs.recorder import Recorder
from fem_snh.runs.stepping import Stepper

__all__ = ["Result", "run"]

#: Seconds by which the other ranks let rank 0 end first; mpirun kills after one.
_PATIENCE = 5.0


@dataclass
class Result:
    """What a run computed.

    ``record`` is run.json's content; ``steps`` its rows, one per attempted load increment; ``u``
    the displacement (a dolfinx Function) at the last load that converged; ``problem`` the rest.
    """

    converged: bool
    status: str
    record: dict[str, Any]
    problem: Problem = field(repr=False)
    out: Path | None = None

    @property
    def steps(self) -> list[dict[str, Any]]:
        return list(self.record["steps"])

    @property
    def u(self) -> Any:
        return self.problem.u

    @property
    def frequencies(self) -> list[float]:
        """The eigenfrequencies [Hz] that the scene's ``modes`` asked for, in ascending order."""
        return list(self.record.get("modes", {}).get("frequencies", ()))


def run(
    scene: str | Path | scenes.Scene,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: bool = True,
    note: Mapping[str, Any] | None = None,
    **overrides: Any,
) -> Result:
    """Solve a scene by load steps. Collective.

    Parameters
    ----------
    scene : a built-in scene's name, a .toml file, or a `fem_snh.scenes.Scene`.
    out : folder for run.json, steps.csv, checkpoint.npz (written after every step) and fields.pvd;
        modes.csv and modes.pvd if the scene asks for modes. A folder that already holds a run is
        refused, unless ``overwrite`` or ``resume``.
    resume : go on from the last step of the run in ``out``, on any number of ranks. It must have
        been of the same scene; `checkpoint.HOW` may differ.
    progress : print a line per step on rank 0.
    note : what run.json is to hold besides.
    overrides : as `fem_snh.scenes.load` takes them: material, E, nu, cells, element, hessian,
        globalization, steps, predictor, quadrature, eigensolver, petsc (a dict of PETSc options),
        and a scene's own parameters.

    A step that fails is rolled back and halved, down to 1/64; when that fails too the run ends with
    ``converged`` False and keeps what it has. Raises BadInput, on every rank; Failed if memory runs
    out or PETSc gives up.
    """
    began = perf_counter()
    if resume and (out is None or overwrite):
        raise BadInput("--resume goes with --out DIR, and without --overwrite")
    # Every rank loads the scene; rank 0 alone says that a key was renamed.
    silent = catch_warnings(action="ignore", category=RenamedKey)
    with silent if comm.rank else nullcontext():
        scene = scenes.load(scene, **overrides)
    folder = None if out is None else Folder(comm, Path(out), overwrite, resume)
    stored = Checkpoint.read(folder, scene) if resume and folder else None
    show = Progress(comm, progress)
    smoothers = multigrid.smoothers(scene.material.E)
    with solver.petsc_failures(), petsc_options(solver.PREFIX, scene.petsc, smoothers) as unused:
        element = elements.element(scene.element, scene.quadrature)
        chosen = scene.material

        def law(nu: float) -> Material:
            return material(chosen.name, chosen.E, nu, **chosen.parameters)

        meshing, working = perf_counter(), process_time()
        domain = make_mesh(comm, scene, element)
        setting_up = perf_counter()

        def made(nu: float) -> Problem:
            return Problem(
                domain,
                element,
                law(nu),
                hold=scene.hold,
                move=scene.move,
                traction=scene.traction,
                reactions=scene.reactions,
                eigensolver=scene.eigensolver,
            )

        problem = made(chosen.nu)
        if scene.start:
            set_initial_state(problem, scene.start)
        probes = Probes(problem.u, scene.probe) if scene.probe else None
        if scene.modes:
            modes.check(problem, scene.modes.count)
        choices = scene.hessian, scene.globalization
        snes = solver.create(problem, *choices)
        nus = scene.nu_continuation
        continuation = PoissonContinuation(nus, made, *choices) if nus else None
        stepper = Stepper(problem, snes, scene.steps, scene.predictor, probes, continuation)
        jit = problem.seconds["jit"] + (continuation.jit if continuation else 0.0)
        seconds = {
            "jit": jit,
            "mesh": setting_up - meshing,
            "setup": perf_counter() - setting_up - jit,
        }
        worked = max(0.0, process_time() - working - jit)
        about = describe(scene, problem, snes) | dict(note or {})
        show.start(about)
        if stored and folder:
            stored.restore(stepper)
            show.resumed(stored.load, stored.finished)
            if stored.finished:
                return Result(True, "converged", stored.record, problem, folder.path)
        checkpoint = Writer(folder, scene, stepper) if folder else None
        earlier = stored.record if stored else None
        recorder = Recorder(about, stepper, folder, checkpoint, seconds, began, worked, earlier)
        with _interrupts(comm, snes) as interrupts, recorder, solver.petsc_failures():
            recorder.keep("running", state=True)
            for step in stepper:
                show.step(step)
                with interrupts.undivided():
                    recorder.step(step)
            if scene.modes and stepper.done:
                found = modes.lowest(
                    problem, scene.modes.density, scene.modes.count, f"{solver.PREFIX}modes_"
                )
                with interrupts.undivided():
                    recorder.modes(found)
        status = "converged" if stepper.done else stepper.failure()
        recorder.keep(status)
        comm.barrier()  # what a rank reads after this is complete
        path = folder.path if folder else None
        show.end(recorder.record, path, unused())
    return Result(stepper.done, status, recorder.record, problem, path)


def _interrupts(comm: MPI.Comm, snes: PETSc.SNES) -> Interrupts:
    """Interruptions that leave rank 0 the time to say so."""
    # Python looks for signals when it is called. On every rank: for a monitor's sake a solver may
    # compute a norm, which is collective.
    snes.getKSP().setMonitor(lambda *_: None)
    return Interrupts(_PATIENCE if comm.rank else 0.0)


def make_mesh(comm: MPI.Comm, scene: scenes.Scene, element: elements.Element) -> meshes.Mesh:
    """The scene's mesh, generated or read. Collective."""
    if isinstance(scene.mesh, Path):
        return meshes.read(comm, scene.mesh)
    cells = {} if scene.cells is None else {"cells": scene.cells}
    return meshes.generate(comm, scene.mesh.source, element.cell, **cells, **scene.mesh.parameters)


@contextmanager
def petsc_options(
    prefix: str, options: dict[str, Any], otherwise: dict[str, Any]
) -> Iterator[Callable[[], list[str]]]:
    """Put a scene's options into PETSc's database under ``prefix``, and take them out again.

    What is already there (the command line of a program that gave it to PETSc) wins, and comes
    before ``otherwise``. Lends a function that lists the options nothing has asked for: PETSc
    is silent about a mistyped one.
    """
    with default_options(prefix, options) as mine, default_options(prefix, otherwise):
        yield lambda: [key for key in mine if not option_used(prefix + key)]
