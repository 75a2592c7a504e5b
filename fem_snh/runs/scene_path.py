"""The path of a scene, in time or with load steps of friction, which estimates follow again."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

from fem_snh import scenes
from fem_snh.accuracy.goals import Goal
from fem_snh.accuracy.lift import NoEstimate
from fem_snh.accuracy.path_errors import Followed, end_of
from fem_snh.assembly.elements import Element
from fem_snh.errors import BadInput
from fem_snh.runs.setup import Setup, set_up

#: Fewest time steps of which half are worth comparing.
_FEWEST_STEPS = 4


class ScenePath:
    """The path of a scene's run: see `fem_snh.accuracy.path_errors.Path`.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    scene : Scene
        The scene.
    setup : Setup
        Its run, at the end.
    """

    def __init__(self, comm: MPI.Comm, scene: scenes.Scene, setup: Setup) -> None:
        self._comm, self._scene, self._setup = comm, scene, setup
        self.taken, motion = setup.stepper.taken, setup.stepper.motion
        self.order = motion.dynamics.integrator.order if motion else None
        self.contact = bool(scene.obstacle or scene.contact or scene.self_contact)

    @property
    def steps(self) -> int:
        """The number of the scene's steps; it raises NoEstimate if half are no comparison."""
        scene = self._scene
        if scene.time is None:
            return scene.steps
        if scene.time.tolerance is not None:
            raise NoEstimate(
                "time.tolerance: expected equal time steps, of which half are compared"
            )
        if scene.time.steps < _FEWEST_STEPS:
            raise NoEstimate(f"time.steps = {scene.time.steps}: expected at least {_FEWEST_STEPS}")
        return scene.time.steps

    def follow(
        self, steps: int, goals: Sequence[Goal], element: Element | None, stiffer: float
    ) -> Followed:
        """See `fem_snh.accuracy.path_errors.Path`."""
        scene, setup = self._with_steps(steps), self._setup
        name = element.name if element else scene.element
        if element and element.has_pressure:  # whose defaults are those of a saddle-point problem
            scene = scene.model_copy(update={"hessian": None, "globalization": None})
        try:
            stiffness = setup.stiffer * stiffer
            again = set_up(self._comm, scene, mesh=setup.mesh, element=element, stiffer=stiffness)
        except BadInput as error:  # a material without a volume term of its own
            raise NoEstimate(f"{name} does not fit: {error}") from None
        try:
            return end_of(again.stepper, again.problem, goals, f"with {steps} steps of {name}")
        finally:
            again.destroy()

    def _with_steps(self, steps: int) -> scenes.Scene:
        """Return the scene with another number of steps."""
        scene = self._scene
        if scene.time is None:
            return scene.model_copy(update={"steps": steps})
        return scene.model_copy(update={"time": scene.time.model_copy(update={"steps": steps})})
