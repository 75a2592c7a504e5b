"""Set up a run: mesh, problem, solver and load stepping of a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

from fem_snh import scenes, solver
from fem_snh.assembly import elements
from fem_snh.cache import Stopwatch
from fem_snh.mesh import mesh as meshes
from fem_snh.problem.definition import Definition, define
from fem_snh.problem.initial_state import initial_velocity, set_initial_state
from fem_snh.problem.probes import Probes
from fem_snh.problem.problem import Problem
from fem_snh.records.run_record import Note, Record
from fem_snh.runs.result import Result
from fem_snh.scenes.build import build, make_material, make_mesh
from fem_snh.steps.cell_pressures import Condensation, choose_condensation, chosen_for_condensed
from fem_snh.steps.stepping import Stepper, StepSolver

if TYPE_CHECKING:
    from fem_snh.accuracy.goal_errors import Estimate


@dataclass(frozen=True)
class Setup:
    """A scene that is ready to be solved.

    Attributes
    ----------
    scene : Scene
        The scene.
    problem : Problem
        The discretised problem.
    snes : PETSc.SNES
        The problem's nonlinear solver.
    stepper : Stepper
        The load steps.
    watch : Stopwatch
        Started at the beginning of the set-up.
    seconds : dict
        Elapsed seconds of the set-up, without compilation: "mesh", "setup".
    processor : float
        This rank's processor seconds of the set-up, without compilation.
    condensation : Condensation
        Whether cell pressures are eliminated.
    mesh : Mesh
        The mesh.
    make : callable or None
        Creates the problem on the same mesh with another element; None in a dynamic scene.
    note : Note or None
        The note on the state of another run, from which this run starts.
    stiffer : float
        The factor by which the problem's penalties are stiffer than the scene's.
    """

    scene: scenes.Scene
    problem: Problem
    snes: PETSc.SNES
    stepper: Stepper
    watch: Stopwatch
    seconds: dict[str, float]
    processor: float
    condensation: Condensation
    mesh: meshes.Mesh
    make: Callable[[elements.Element], Problem] | None = None
    note: Note | None = None
    stiffer: float = 1.0

    @property
    def depends_on_path(self) -> bool:
        """Whether a state depends on those before it. Collective."""
        return self.make is None or self.problem.depends_on_path

    def result(self, record: Record, out: Path | None, estimate: Estimate | None = None) -> Result:
        """Return the result of the run, whose record is complete."""
        ended = record["converged"], record["status"]
        return Result(*ended, record, self.problem, out, self.stepper.motion, estimate)

    def destroy(self) -> None:
        """Destroy the solvers; the problem remains. Collective."""
        solver.destroy(self.snes)
        self.stepper.solver.destroy()


def set_up(
    comm: MPI.Comm, scene: scenes.Scene, resumed: bool = False, mesh: meshes.Mesh | None = None,
    stiffer: float = 1.0, element: elements.Element | None = None,
) -> Setup:  # fmt: skip
    """Return a scene's problem, solver and steps. Collective.

    Parameters
    ----------
    resumed : bool
        Do not read the run ``start.run``, as the caller sets the state from a checkpoint.
    mesh, element : optional
        In place of the scene's.
    stiffer : float
        The factor by which penalties are stiffer than the scene's.

    Raises
    ------
    BadInput
        On every rank, for a scene that does not fit its mesh, its material or its element.
    """
    watch = Stopwatch()
    mesh = mesh or make_mesh(comm, scene)
    meshed = watch.seconds
    definition, u = define_scene(scene, comm, mesh)

    def made(problem: Problem) -> Problem:
        problem.scale_penalties(stiffer)
        if problem is not first and problem.element.degree == first.element.degree:
            problem.dirichlet.offset = first.dirichlet.offset
        return problem

    def make(other: elements.Element) -> Problem:
        return made(definition.problem(other))

    def at_ratio(nu: float) -> Problem:
        return made(_at_ratio(definition, scene, nu).problem(element))

    first = definition.problem(element, None if element else u)
    problem, note = made(first), None
    element = problem.element
    if scene.start and scene.start.run is not None:
        from fem_snh.runs.start import start_from_run

        note = start_from_run(problem, scene, read=not resumed)
    elif scene.start and (scene.start.displaces or not scene.time):
        set_initial_state(problem, scene.start)
    probes = Probes(problem.u, scene.probe) if scene.probe else None
    choices = scene.hessian, scene.globalization
    snes = solver.create(problem, *choices)
    continuation = None
    if scene.nu_continuation:
        from fem_snh.steps.poisson_continuation import PoissonContinuation

        continuation = PoissonContinuation(scene.nu_continuation, at_ratio, *choices)
    steps, every, bones = scene.steps, 1, None
    if scene.time:
        steps, every = scene.time.steps, scene.time.output_every
    if scene.bone:
        from fem_snh.problem.bones import BoneRecords

        bones = BoneRecords(problem)
    mixed = elements.with_cell_pressures(element)
    wanted, why = scene.static_condensation, _why_condensed(scene)
    condensation = choose_condensation(wanted, problem, lambda: make(mixed), why)
    pressures = condensation.pressures
    blend = bones.blend() if bones and scene.predictor == "bones" else None
    step = StepSolver(problem, snes, scene.predictor, continuation, pressures, blend)
    if step.motion:
        velocity = initial_velocity(problem, scene.start) if scene.start else None
        step.motion.start(problem, velocity)
    asked = "stability = true"
    stability = solver.EquilibriumStability(problem, asked) if scene.stability else None
    stepper = Stepper(step, steps, probes, bones, every, stability)
    seconds = {"mesh": meshed, "setup": watch.seconds - meshed}
    other = None if scene.time else make
    return Setup(
        scene, problem, snes, stepper, watch, seconds, watch.processor, condensation, mesh, other,
        note, stiffer,
    )  # fmt: skip


def _why_condensed(scene: scenes.Scene) -> str:
    """Return why cell pressures are eliminated at any Poisson's ratio; "" if the ratio decides."""
    if reason := scenes.condensation_reason(scene):
        return reason
    if scene.start is not None and scene.start.run is None:
        return "a start far from equilibrium, where the energy has to be minimised"
    choices = {"hessian": scene.hessian, "globalization": scene.globalization}
    return chosen_for_condensed(solver.PREFIX, choices)


def define_scene(
    scene: scenes.Scene, comm: MPI.Comm, mesh: meshes.Mesh | None = None
) -> tuple[Definition, Any]:
    """Return the definition of a scene's problem, and its displacement Function. Collective."""
    built, motion = build(scene, comm, mesh), Record()
    if scene.time:
        from fem_snh.steps.dynamics.dynamics import Dynamics

        create = partial(Dynamics, **built.time, tolerance=scene.time.tolerance)
        motion = {"motion": create, "integrator": scene.time.integrator}
    defined = define(**built.statement, **motion)
    defined = replace(defined, u=None, reactions=scene.reactions, volumes=scene.volumes)
    return defined, built.statement["u"]


def _at_ratio(definition: Definition, scene: scenes.Scene, nu: float) -> Definition:
    """Return a definition at another Poisson's ratio.

    If there are several materials, a material with a smaller ratio keeps it.
    """
    several, fillings = len(scene.materials) > 1, []
    for choice, filling in zip(scene.materials, definition.fillings, strict=True):
        ratio = choice.nu if several and choice.nu < nu else nu
        fillings.append(filling._replace(material=make_material(choice, ratio)))
    return replace(definition, fillings=fillings)
