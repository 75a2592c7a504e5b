"""The path of a scene, in time or with load steps of friction, which estimates follow again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from fem_snh import scenes
from fem_snh.accuracy.path_errors import GoalHistory, Path
from fem_snh.assembly.elements import Element
from fem_snh.runs.setup import Setup, set_up
from fem_snh.steps.stepping import Stepper


def scene_path(setup: Setup, history: GoalHistory | None) -> Path:
    """Return the path of a run that is at its end; a repetition sets the scene up again.

    Without its ``history`` it is followed again for that.
    """

    @contextmanager
    def repeat(steps: int, element: Element | None, stiffer: float) -> Iterator[Stepper]:
        scene, comm = _with_steps(setup.scene, steps), setup.problem.comm
        if element and element.has_pressure:  # whose defaults are those of a saddle-point problem
            scene = scene.model_copy(update={"hessian": None, "globalization": None})
        stiffness = setup.stiffer * stiffer
        again = set_up(comm, scene, mesh=setup.mesh, element=element, stiffer=stiffness)
        if update := setup.snes.getUpdate():
            again.snes.setUpdate(*update)
        try:
            yield again.stepper
        finally:
            again.destroy()

    return Path(setup.stepper, repeat, history)


def _with_steps(scene: scenes.Scene, steps: int) -> scenes.Scene:
    """Return the scene with another number of steps."""
    if scene.time is None:
        return scene.model_copy(update={"steps": steps})
    return scene.model_copy(update={"time": scene.time.model_copy(update={"steps": steps})})
