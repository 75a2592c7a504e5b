"""The path of a scene, in time or with load steps of friction, which estimates follow again."""

from __future__ import annotations

from collections.abc import Sequence

from fem_snh import scenes
from fem_snh.accuracy.goal_errors import ElementDoesNotFit, NoEstimate
from fem_snh.accuracy.goals import Goal
from fem_snh.accuracy.path_errors import Followed, Path, end_of
from fem_snh.assembly.elements import Element
from fem_snh.errors import BadInput
from fem_snh.runs.setup import Setup, set_up


class ScenePath(Path):
    """The path of a scene's run: see `fem_snh.accuracy.path_errors.Path`.

    Parameters
    ----------
    setup : Setup
        The run, at its end.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup, self._scene, self._taken = setup, setup.scene, setup.stepper.taken

    @property
    def taken(self) -> int:
        """The number of steps taken."""
        return self._taken

    @property
    def steps(self) -> int:
        """The number of the scene's steps; it raises NoEstimate if they are not equal."""
        time = self._scene.time
        if time and time.tolerance is not None:
            raise NoEstimate(
                "time.tolerance: expected equal time steps, of which half are compared"
            )
        return time.steps if time else self._scene.steps

    def follow(
        self, steps: int, goals: Sequence[Goal], element: Element | None, stiffer: float
    ) -> Followed:
        """See `fem_snh.accuracy.path_errors.Path`."""
        scene, setup = self._with_steps(steps), self._setup
        name = element.name if element else scene.element
        if element and element.has_pressure:  # whose defaults are those of a saddle-point problem
            scene = scene.model_copy(update={"hessian": None, "globalization": None})
        try:
            again = set_up(
                setup.problem.comm,
                scene,
                mesh=setup.mesh,
                element=element,
                stiffer=setup.stiffer * stiffer,
            )
        except BadInput as error:  # a material without a volume term of its own
            raise ElementDoesNotFit(f"{name} does not fit: {error}") from None
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
