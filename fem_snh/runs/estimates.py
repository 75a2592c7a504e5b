"""Estimate the errors of a scene's goals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from typing import TYPE_CHECKING

from fem_snh.accuracy.curves import curves_of
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
from fem_snh.accuracy.path_errors import (
    GoalHistory,
    estimate_on_path,
    values_on_path,
)
from fem_snh.accuracy.refinement import left_by_uniform
from fem_snh.cache import Stopwatch
from fem_snh.errors import BadInput, Failed
from fem_snh.problem.goals import Goal, names_of
from fem_snh.problem.problem import Problem
from fem_snh.runs.level_meshes import coarser_scene, is_refined_locally
from fem_snh.runs.progress import Progress
from fem_snh.runs.result import Result
from fem_snh.runs.scene_goals import GoalStates, goal_loads
from fem_snh.runs.scene_replay import scene_path
from fem_snh.runs.setup import Setup
from fem_snh.scenes import Scene

if TYPE_CHECKING:
    from fem_snh.runs.level_runs import Level
    from fem_snh.runs.recorder import Recorder


def estimate_errors(
    setup: Setup,
    goals: Sequence[Goal],
    recorder: Recorder,
    printed: Progress,
    level: Level | None,
    again: Callable[..., Result] | None,
) -> Estimate:
    """Return the errors of goals of a run that is at its end, with their bounds. Collective.

    Parameters
    ----------
    setup : Setup
        The run, at its end.
    goals : sequence of Goal
        The goals.
    recorder : Recorder
        Has the goals along the path and the states in which they are evaluated. If it writes
        fields, the errors of all goals are distributed to the cells; otherwise only if the scene
        names goals or, in a run to an accuracy, if the mesh is refined locally. Else only the
        largest error is distributed.
    printed : Progress
        Prints the cost before the errors are known.
    level : Level or None
        The level of a run to an accuracy, whose levels measure the errors.
    again : callable or None
        Runs another scene, which measures them otherwise; None: nothing does.
    """
    if again and not level and setup.scene.error == "coarser":
        estimate = _errors_of_coarser(setup, goals, recorder, printed, again)
    else:
        estimate = _estimated(setup, goals, recorder, printed.estimating)
        if level:
            level.measure(estimate)
        elif again and not estimate.reason:
            _measure(setup, goals, recorder.history, estimate, again, printed)
    if recorder.history and not level:
        estimate.history = recorder.history
    return estimate


def _estimated(
    setup: Setup,
    goals: Sequence[Goal],
    recorder: Recorder,
    announce: Announce,
) -> Estimate:
    """Return the errors of goals, without bounds; see `estimate_errors`. Collective."""
    scene, problem, states = setup.scene, setup.problem, recorder.states
    if states is None:
        path, at = scene_path(setup, recorder.history), goal_loads(scene, goals)
        most = _max_memory(scene)
        found = estimate_on_path(problem, path, goals, announce, setup.mesh, most, at)
        found.duration = scene.duration
        return found
    fields = recorder.writes_fields
    return _of_states(
        setup, goals, states, lambda there: _errors_at(setup, there, announce, fields)
    )


def _of_states(
    setup: Setup,
    goals: Sequence[Goal],
    states: GoalStates,
    errors: Callable[[Sequence[Goal]], Estimate],
) -> Estimate:
    """Return the ``errors`` of goals, each in the state in which it is evaluated. Collective."""
    if states.reason:
        with estimating(setup.problem, goals) as estimate:
            raise NoEstimateOnAnyMesh(states.reason)
        return estimate
    by_load = {}
    for load, goals_there in states.by_load().items():
        with states.at(load):
            by_load[load] = errors(goals_there)
    return Estimate.merged(by_load, names_of(goals))


def _measure(
    setup: Setup,
    goals: Sequence[Goal],
    history: GoalHistory | None,
    estimate: Estimate,
    again: Callable[..., Result],
    printed: Progress,
) -> None:
    """Add the bounds that a run with half the cells, in time half the steps, too, measures."""
    coarser, dofs, why = _of_coarser_run(setup.scene, estimate, again, printed, alone=True)
    if coarser is None:
        estimate.left_out.append(without_bounds(why))
        return
    problem = setup.problem
    left = left_by_uniform(dofs, problem.dofs, problem.element.degree, problem.kinematics.dim)
    estimate.goals = with_bounds(estimate.goals, [coarser.goals], left)
    if history and coarser.history:
        estimate.curves = curves_of(estimate, goals, history, coarser.history)


def _errors_of_coarser(
    setup: Setup,
    goals: Sequence[Goal],
    recorder: Recorder,
    printed: Progress,
    again: Callable[..., Result],
) -> Estimate:
    """Return the differences to the corrected goals of a run with half the cells. Collective.

    Their bounds are those of that run, which one with a quarter of the cells measures.
    """
    scene, history = setup.scene, recorder.history
    if recorder.states is not None:
        run = _of_states(setup, goals, recorder.states, partial(_values, setup.problem))
    else:
        path, at = scene_path(setup, history), goal_loads(scene, goals)
        run = values_on_path(setup.problem, path, goals, at)
    scene = scene.model_copy(update={"error": True})
    coarser, _, why = _of_coarser_run(scene, run, again, printed)
    if coarser is None:
        run.reason = why
        return run
    found = replace(coarser, indicators={}, seconds=run.seconds, loads=run.loads, curves={})
    found.duration, found.history = scene.duration, None
    found.goals = {name: goal.known_from(coarser.goals[name]) for name, goal in run.goals.items()}
    if history:
        places = {name: i for i, name in enumerate(names_of(goals))}
        for name, curve in coarser.curves.items():
            values = {load: float(all_[places[name]]) for load, all_ in history.values.items()}
            found.curves[name] = curve.seen_from(values)
    return found


def _values(problem: Problem, goals: Sequence[Goal]) -> Estimate:
    """Return goals without errors. Collective."""
    with estimating(problem, goals) as estimate:
        pass
    return estimate


def _of_coarser_run(
    scene: Scene,
    estimate: Estimate,
    again: Callable[..., Result],
    printed: Progress,
    alone: bool = False,
) -> tuple[Estimate | None, int, str]:
    """Return the errors of a run with half the cells and its unknowns, or None and why.

    Its seconds are added to those of ``estimate``.
    """
    coarser, what = coarser_scene(scene)
    if coarser is None:
        return None, 0, what
    printed.line(f"  a run with {what} {'measures the estimate' if alone else 'has the errors'}")
    watch, failed = Stopwatch(), "the steps fail"
    try:
        result = again(coarser, alone=alone)
        if result.estimate and not result.estimate.reason:
            return result.estimate, result.problem.dofs, ""
        failed = result.estimate.reason if result.estimate else failed
    except (BadInput, Failed) as error:
        failed = str(error)
    finally:
        estimate.seconds += watch.seconds
    return None, 0, f"the run with {what} has none: {failed}"


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
