"""Estimate the errors of a scene's goals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import TYPE_CHECKING

from fem_snh.accuracy.estimate import (
    Announce,
    EstimateOptions,
    estimate_error,
    estimating,
    without_bounds,
)
from fem_snh.accuracy.goal_errors import (
    Estimate,
    NoEstimateOnAnyMesh,
    with_bounds,
)
from fem_snh.accuracy.path_errors import GoalHistory, estimate_on_path
from fem_snh.accuracy.refinement import left_by_uniform
from fem_snh.cache import Stopwatch
from fem_snh.errors import BadInput, Failed
from fem_snh.problem.goals import Goal, names_of
from fem_snh.runs.level_meshes import coarser_scene, is_refined_locally
from fem_snh.runs.result import Result
from fem_snh.runs.scene_goals import GoalStates, goal_loads
from fem_snh.runs.scene_replay import scene_path
from fem_snh.runs.setup import Setup
from fem_snh.scenes import Scene

if TYPE_CHECKING:
    from fem_snh.runs.level_runs import Level


def estimate_errors(
    setup: Setup,
    goals: Sequence[Goal],
    announce: Announce,
    fields: bool,
    states: GoalStates | GoalHistory | None,
) -> Estimate:
    """Return the errors of goals of a run that is at its end. Collective.

    Parameters
    ----------
    setup : Setup
        The run, at its end.
    goals : sequence of Goal
        The goals.
    announce : callable
        Called with the estimate before the errors are known: it has the cost only.
    fields : bool
        Whether fields of the errors are written. The errors of all goals are then distributed to
        the cells; otherwise only if the scene names goals or, in a run to an accuracy, if the mesh
        is refined locally. Else only the largest error is distributed.
    states : GoalStates or GoalHistory or None
        The states in which the goals are evaluated; of a path, all of them; None: unknown.
    """
    scene, problem = setup.scene, setup.problem
    if not isinstance(states, GoalStates):
        path, at = scene_path(setup, states), goal_loads(scene, goals)
        most = _max_memory(scene)
        found = estimate_on_path(problem, path, goals, announce, setup.mesh, most, at)
        found.duration = scene.duration
        return found
    if states.reason:
        with estimating(setup.problem, goals) as estimate:
            raise NoEstimateOnAnyMesh(states.reason)
        return estimate
    by_load = {}
    for load, goals_there in states.by_load().items():
        with states.at(load):
            by_load[load] = _errors_at(setup, goals_there, announce, fields)
    return Estimate.merged(by_load, names_of(goals))


def measure_errors(
    setup: Setup,
    estimate: Estimate,
    level: Level | None,
    again: Callable[..., Result] | None,
    printed: Callable[[str], None],
) -> None:
    """Add the bounds that other levels measure, or a run with half the cells. Collective.

    That run has half the cells along an edge, in time half the steps, too.

    Parameters
    ----------
    setup : Setup
        The run, at its end.
    estimate : Estimate
        The estimate of its errors.
    level : Level or None
        The level of a run to an accuracy; None: another run measures the errors.
    again : callable or None
        Runs another scene; None: nothing measures them.
    printed : callable
        Prints a line.
    """
    if level:
        level.measure(estimate)
    if level or again is None or estimate.reason:
        return
    scene, why = coarser_scene(setup.scene)
    if scene is not None:
        printed(f"  a run with {why} measures the estimate")
        watch = Stopwatch()
        try:
            result, failed = again(scene, alone=True), "the steps fail"
        except (BadInput, Failed) as error:
            result, failed = None, str(error)
        estimate.seconds += watch.seconds
        coarser = result.estimate if result else None
        if result and coarser and not coarser.reason:
            problem, dofs = setup.problem, result.problem.dofs
            degree, dim = problem.element.degree, problem.kinematics.dim
            left = left_by_uniform(dofs, problem.dofs, degree, dim)
            estimate.goals = with_bounds(estimate.goals, [coarser.goals], left)
            return
        why = f"the run with {why} has none: {coarser.reason if coarser else failed}"
    estimate.left_out.append(without_bounds(why))


def _errors_at(setup: Setup, goals: Sequence[Goal], announce: Announce, fields: bool) -> Estimate:
    """Return the errors of goals in the present state; see `estimate_errors`. Collective."""
    scene, problem, wanted = setup.scene, setup.problem, setup.scene.accuracy
    assert setup.make is not None
    named = bool(wanted and wanted.goals)
    locate_all = fields or (is_refined_locally(scene) if scene.within else named)
    options = EstimateOptions(scene.within or 0.0, scene.stability, locate_all, _max_memory(scene))
    return estimate_error(problem, setup.make, goals, announce, setup.mesh, options)


def _max_memory(scene: Scene) -> float:
    """Return the memory that a better element may have [bytes]."""
    megabytes = scene.accuracy.max_memory if scene.accuracy and not scene.within else None
    return inf if megabytes is None else 1e6 * megabytes
