"""Estimate the errors of a scene's goals."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from fem_snh.accuracy.estimate import (
    Announce,
    EstimateOptions,
    estimate_error,
    estimating,
)
from fem_snh.accuracy.goal_errors import Estimate, NoEstimateOnAnyMesh, depends_on_path
from fem_snh.accuracy.goals import Goal, names_of
from fem_snh.accuracy.path_errors import estimate_on_path
from fem_snh.runs.level_meshes import is_refined_locally
from fem_snh.runs.scene_goals import GoalStates
from fem_snh.runs.scene_replay import scene_path
from fem_snh.runs.setup import Setup


def estimate_errors(
    setup: Setup,
    goals: Sequence[Goal],
    announce: Announce,
    fields: bool,
    states: GoalStates | None = None,
) -> Estimate:
    """Return the errors of goals of a run, at its end. Collective.

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
    states : GoalStates, optional
        The states in which the goals are evaluated; default: the last state.
    """
    if states is None:
        return _errors_at(setup, goals, announce, fields)
    if states.reason:
        with estimating(setup.problem, goals) as estimate:
            raise NoEstimateOnAnyMesh(states.reason)
        return estimate
    found = {}
    for load, goals_there in states.by_load().items():
        with states.at(load):
            found[load] = _errors_at(setup, goals_there, announce, fields)
    return Estimate.merged(found, names_of(goals))


def _errors_at(setup: Setup, goals: Sequence[Goal], announce: Announce, fields: bool) -> Estimate:
    """Return the errors of goals in the present state; see `estimate_errors`. Collective."""
    scene, problem = setup.scene, setup.problem
    wanted = scene.accuracy
    megabytes = wanted.max_memory if wanted and not scene.within else None
    max_memory = inf if megabytes is None else 1e6 * megabytes
    if setup.make is None or depends_on_path(problem):
        path = scene_path(setup)
        return estimate_on_path(problem, path, goals, announce, setup.mesh, max_memory)
    named = bool(wanted and wanted.goals)
    locate_all = fields or (is_refined_locally(scene) if scene.within else named)
    options = EstimateOptions(scene.within or 0.0, scene.stability, locate_all, max_memory)
    return estimate_error(problem, setup.make, goals, announce, setup.mesh, options)
