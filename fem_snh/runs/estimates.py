"""Estimate the errors of a scene's goals."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from typing import TYPE_CHECKING

from fem_snh import scenes
from fem_snh.accuracy.coarser_meshes import CoarserMeshes, estimate_by_coarser_meshes
from fem_snh.accuracy.estimate import (
    EstimateOptions,
    estimate_error,
    estimate_with,
    largest_error,
)
from fem_snh.accuracy.goal_errors import Estimate, NoEstimate, NoEstimateOnAnyMesh, depends_on_path
from fem_snh.accuracy.goals import Goal, names_of
from fem_snh.accuracy.path_errors import Followed, end_of, estimate_on_path
from fem_snh.choices import COARSER_MESHES, LIFTED_ELEMENT
from fem_snh.errors import BadInput
from fem_snh.runs.goals import GoalStates, scene_goals
from fem_snh.runs.level_meshes import cells_of, is_exact, is_refined_locally
from fem_snh.runs.scene_path import ScenePath
from fem_snh.runs.setup import Setup, set_up
from fem_snh.runs.vibrations import vibrations

if TYPE_CHECKING:
    from fem_snh.runs.levels import Level

#: Cells along an edge of the coarser meshes, over those of the run; the fewest of the coarsest one,
#: by the degree: with one cell of degree 2 a quarter turn finds a fifth of its error.
_PARTS, _FEWEST = (0.5, 0.25), {1: 4, 2: 2}


def estimate_errors(
    setup: Setup,
    goals: Sequence[Goal],
    announce: Callable[[Estimate], None],
    fields: bool,
    level: Level | None = None,
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
        Called with the cost, before the errors are estimated.
    fields : bool
        Whether the errors of all goals in cells are written; otherwise they are distributed to
        cells if the scene names goals, and that of the largest error alone if it names none.
    level : Level, optional
        The level of a run to an accuracy: without fields the errors of those goals are distributed
        that are not within it.
    states : GoalStates, optional
        The states that goals are of; default: the end.
    """
    if states is None:
        return _errors_at(setup, goals, announce, fields, level)
    if states.reason:
        return _without(setup, goals, states.reason)
    found = {}
    for load, goals_there in states.by_load().items():
        with states.at(load):
            found[load] = _errors_at(setup, goals_there, announce, fields, level)
    return Estimate.merged(found, names_of(goals))


def _without(setup: Setup, goals: Sequence[Goal], reason: str) -> Estimate:
    """Return goals without errors, for a reason that holds on any mesh. Collective."""

    def refuse(estimate: Estimate) -> None:
        raise NoEstimateOnAnyMesh(reason)

    return estimate_with(refuse, setup.problem, goals)


def _errors_at(
    setup: Setup,
    goals: Sequence[Goal],
    announce: Callable[[Estimate], None],
    fields: bool,
    level: Level | None,
) -> Estimate:
    """Return the errors of goals in the present state; see `estimate_errors`. Collective."""
    scene, problem = setup.scene, setup.problem
    wanted = scene.accuracy
    if wanted and wanted.estimate == COARSER_MESHES:
        return _by_coarser_meshes(setup, goals, announce)
    megabytes = wanted.max_memory if wanted and not scene.within else None
    max_memory = inf if megabytes is None else 1e6 * megabytes
    if setup.make is None or depends_on_path(problem):
        path = ScenePath(setup)
        return estimate_on_path(problem, path, goals, announce, setup.mesh, max_memory)

    def choose(estimate: Estimate, names: Sequence[str]) -> Collection[str]:
        if fields:
            return names
        if level:
            return level.located(estimate, names, is_refined_locally(scene))
        return names if wanted and wanted.goals else largest_error(estimate, names)

    options = EstimateOptions(scene.within or 0.0, scene.stability, choose, max_memory)
    estimate = estimate_error(problem, setup.make, goals, announce, setup.mesh, options)
    if estimate.lacks_memory and not scene.within:
        other = _by_coarser_meshes(setup, goals, announce, estimate.reason)
        reason = f"{estimate.reason}; {other.reason}"
        return replace(estimate, reason=reason) if other.reason else other
    return estimate


def _by_coarser_meshes(
    setup: Setup,
    goals: Sequence[Goal],
    announce: Callable[[Estimate], None],
    because: str = "",
) -> Estimate:
    """Return the errors of goals by the scene on coarser meshes. Collective."""
    if setup.problem.load < 1:
        reason = (
            f"coarser meshes show the errors at load 1, not at load {setup.problem.load:.6g}: "
            f"expected accuracy.estimate = '{LIFTED_ELEMENT}'"
        )
        return _without(setup, goals, reason)
    coarsen = partial(coarser_meshes, setup)
    return estimate_by_coarser_meshes(setup.problem, coarsen, goals, announce, because)


def coarser_meshes(setup: Setup) -> CoarserMeshes:
    """Return coarser meshes of a scene's body.

    Raises
    ------
    NoEstimate
        For a mesh of a file, and with too few cells.
    """
    scene, own = setup.scene, 1.0
    if isinstance(scene.mesh, scenes.Lattice):
        edges = [scene.mesh.cell / part for part in _PARTS]
        label = f"lattices with cells of {edges[0]:g} and {edges[1]:g}"
        others = [
            scene.model_copy(update={"mesh": scene.mesh.model_copy(update={"cell": edge})})
            for edge in edges
        ]
        fineness = list(_PARTS)
    elif is_exact(scene):
        assert scene.cells is not None
        own, cells = float(scene.cells), [cells_of(scene, part * scene.cells) for part in _PARTS]
        fewest = _FEWEST[setup.problem.element.degree]
        if cells[1] < fewest or not cells[1] < cells[0] < own:
            raise NoEstimate(
                f"in place of {scene.cells} cells along an edge coarser meshes would have "
                f"{cells[0]} and {cells[1]}, as the geometry admits: expected two meshes, and "
                f"{fewest} or more"
            )
        label = f"meshes with {cells[0]} and {cells[1]} cells along an edge"
        others = [scene.model_copy(update={"cells": count}) for count in cells]
        fineness = [float(count) for count in cells]
    else:
        raise NoEstimate("the mesh of a file has no coarser one")
    runs = [partial(_follow, setup, other) for other in others]
    return CoarserMeshes((own, fineness[0], fineness[1]), label, runs)


def _follow(setup: Setup, scene: scenes.Scene) -> Followed:
    """Solve a scene and return its goals; see `CoarserMeshes`. Collective."""
    try:
        again = set_up(setup.problem.comm, scene, stiffer=setup.stiffer)
    except BadInput as error:
        raise NoEstimate(f"on a coarser mesh: {error}") from None
    try:
        goals = scene_goals(again, vibrations(again))
        return end_of(again.stepper, again.problem, goals, "on a coarser mesh")
    except BadInput as error:  # cells that are too large for the radius of a probe
        raise NoEstimate(f"on a coarser mesh: {error}") from None
    finally:
        again.destroy()
