"""Estimate the errors of a scene's goals."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

from fem_snh import scenes
from fem_snh.accuracy.coarser_meshes import add_extrapolated, check_coarsening
from fem_snh.accuracy.estimate import (
    Announce,
    EstimateOptions,
    estimate_error,
    estimating,
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

if TYPE_CHECKING:
    from fem_snh.runs.levels import Level

#: Cells along an edge of the coarser meshes, over those of the run; the fewest of the coarsest one,
#: by the degree: with one cell of degree 2 a quarter turn finds a fifth of its error.
_PARTS, _FEWEST = (0.5, 0.25), {1: 4, 2: 2}


def estimate_errors(
    setup: Setup,
    goals: Sequence[Goal],
    announce: Announce,
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
    with estimating(setup.problem, goals) as estimate:
        raise NoEstimateOnAnyMesh(reason)
    return estimate


def _errors_at(
    setup: Setup,
    goals: Sequence[Goal],
    announce: Announce,
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
    announce: Announce,
    because: str = "",
) -> Estimate:
    """Return the errors of goals by the scene on coarser meshes. Collective."""
    if setup.problem.load < 1:
        reason = (
            f"coarser meshes show the errors at load 1, not at load {setup.problem.load:.6g}: "
            f"expected accuracy.estimate = '{LIFTED_ELEMENT}'"
        )
        return _without(setup, goals, reason)
    with estimating(setup.problem, goals) as estimate:
        check_coarsening(setup.problem)
        others, fineness, label = _coarser_scenes(setup)
        estimate.element, estimate.coarser = setup.problem.element.name, label
        announce(estimate)
        runs = [_follow(setup, other) for other in others]
        add_extrapolated(estimate, setup.problem, goals, runs, fineness)
        left_out = f"the errors are those of {label}" + (f", as {because}" if because else "")
        estimate.left_out.append(left_out)
    return estimate


def _coarser_scenes(setup: Setup) -> tuple[list[scenes.Scene], tuple[float, float, float], str]:
    """Return a scene on two coarser meshes, see `add_extrapolated`, and what they are.

    Raises
    ------
    NoEstimate
        For a mesh of a file, and with too few cells.
    """
    scene = setup.scene
    if isinstance(scene.mesh, scenes.Lattice):
        edges = [scene.mesh.cell / part for part in _PARTS]
        meshes = [scene.mesh.model_copy(update={"cell": edge}) for edge in edges]
        others = [scene.model_copy(update={"mesh": mesh}) for mesh in meshes]
        label = f"lattices with cells of {edges[0]:g} and {edges[1]:g}"
        return others, (1.0, *_PARTS), label
    if not is_exact(scene):
        raise NoEstimate("the mesh of a file has no coarser one")
    assert scene.cells is not None
    first, second = (cells_of(scene, part * scene.cells) for part in _PARTS)
    fewest = _FEWEST[setup.problem.element.degree]
    if second < fewest or not second < first < scene.cells:
        raise NoEstimate(
            f"in place of {scene.cells} cells along an edge coarser meshes would have "
            f"{first} and {second}, as the geometry admits: expected two meshes, and "
            f"{fewest} or more"
        )
    others = [scene.model_copy(update={"cells": count}) for count in (first, second)]
    label = f"meshes with {first} and {second} cells along an edge"
    return others, (float(scene.cells), float(first), float(second)), label


def _follow(setup: Setup, scene: scenes.Scene) -> Followed:
    """Solve a scene on a coarser mesh and return its goals. Collective."""
    try:
        again = set_up(setup.problem.comm, scene, stiffer=setup.stiffer)
    except BadInput as error:
        raise NoEstimate(f"on a coarser mesh: {error}") from None
    try:
        goals = scene_goals(again)
        return end_of(again.stepper, again.problem, goals, "on a coarser mesh")
    except BadInput as error:  # cells that are too large for the radius of a probe
        raise NoEstimate(f"on a coarser mesh: {error}") from None
    finally:
        again.destroy()
