"""Estimate the errors of a scene's goals."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fem_snh import scenes
from fem_snh.accuracy.estimate import Estimate, estimate_error
from fem_snh.accuracy.goals import Goal
from fem_snh.accuracy.lift import depends_on_path
from fem_snh.runs.setup import Setup


def estimate_errors(
    scene: scenes.Scene,
    setup: Setup,
    goals: Sequence[Goal],
    announce: Callable[[Estimate], None],
    fields: bool,
) -> Estimate:
    """Return the errors of goals at the end of a run. Collective.

    Parameters
    ----------
    scene : Scene
        The scene.
    setup : Setup
        Its run, at the end.
    goals : sequence of Goal
        The goals.
    announce : callable
        Called with the cost, before the errors are estimated.
    fields : bool
        Whether the errors of all goals in cells are written; otherwise they are distributed to
        cells if the scene names goals, and that of the largest error alone if it names none.
    """
    problem = setup.problem
    if setup.make is None or depends_on_path(problem):
        from fem_snh.accuracy.path_errors import estimate_on_path
        from fem_snh.runs.scene_path import ScenePath

        return estimate_on_path(problem, ScenePath(scene, setup), goals, announce)
    located = "all" if fields or (scene.accuracy and scene.accuracy.goals) else "largest"
    if scene.within and not fields:
        from fem_snh.runs.levels import is_refined_locally

        located = "all" if is_refined_locally(scene) else "largest"
    made = problem, setup.make
    return estimate_error(*made, goals, announce, setup.mesh, located, scene.stability)
