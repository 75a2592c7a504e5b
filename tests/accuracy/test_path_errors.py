"""Errors of scenes whose end depends on the path: friction, multipliers and time."""

from __future__ import annotations

from functools import lru_cache

from mpi4py import MPI

import numpy as np
import pytest
from running import solve

from fem_snh import scenes
from fem_snh.accuracy.goal_errors import GoalError
from fem_snh.scenes import Accuracy, Geometry, Hold, MaterialChoice, Obstacle, Scene
from fem_snh.tables.amplitudes import Amplitude

mpi = pytest.mark.mpi

FORCE = "upper.force.y"


def seal(cells, **keys):
    """Return the force on an O-ring that is pressed by 15 % between frictional plates."""
    keys = {"cells": cells, "steps": 3, "squeeze": 0.15, "error": True} | keys
    return solve(scenes.load("seal", **keys))


@pytest.mark.one_debian
def test_corrected_force_does_not_depend_on_the_mesh_nor_on_its_penalty():
    coarse, fine = (seal(cells).estimate.goals[FORCE] for cells in (4, 8))
    assert coarse.parts.keys() == {"load steps", "mesh", "penalty"}
    assert abs(fine.value / coarse.value - 1) > 0.015
    assert abs(coarse.parts["penalty"]) > 0.05 * abs(coarse.value)
    # The penalty is inverse to the size of the cells.
    assert coarse.parts["penalty"] / fine.parts["penalty"] == pytest.approx(2.0, rel=0.1)
    assert fine.corrected == pytest.approx(coarse.corrected, rel=0.01)


@pytest.mark.one_debian
@pytest.mark.parametrize(("method", "limit"), [("penalty", 0.01), ("augmented_lagrangian", 0.4)])
def test_sticking_is_a_penalty_too(method, limit):
    """A soft one, beside the exact pressure of multipliers too, has the force of a stiff one."""

    def force(stiffness):
        built_in = scenes.load("press", cells=2, to=0.8, steps=2, element="Q2", error=True)
        keys = {"stiffness": stiffness, "friction": 0.3, "method": method}
        obstacles = [obstacle.model_copy(update=keys) for obstacle in built_in.obstacle]
        estimate = solve(built_in.model_copy(update={"obstacle": obstacles})).estimate
        goal = estimate.goals["plate.force.z"]
        return goal.value, goal.value + goal.parts["penalty"]

    (soft, of_soft), (_, of_stiff) = force(2e5), force(1e7)
    assert abs(soft) < 0.98 * abs(of_stiff)
    assert of_soft == pytest.approx(of_stiff, abs=limit * abs(of_stiff - soft))


def turned_foot(steps, **keys):
    """Return a ball that is pressed into a cube, then turned about an axis beside it."""
    foot = Obstacle(
        name="foot", shape={"sphere": {"center": (0.5, 0.5, 1.6), "radius": 0.6}}, friction=0.3,
        translate=(0, 0, -0.15), table="down",
        rotate={"axis": (0, 0, 1), "angle": 1.2, "through": (0.3, 0.5, 0), "table": "turn"},
    )  # fmt: skip
    tables = {"down": [(0, 0), (0.5, 1), (1, 1)], "turn": [(0, 0), (0.5, 0), (1, 1)]}
    scene = Scene(
        name="foot", mesh=Geometry(source="cube"), cells=2, element="Q1P0", steps=steps,
        material=MaterialChoice(name="stable_neo_hookean", E=1e4, nu=0.45),
        hold=[Hold(group="bottom")], obstacle=[foot], accuracy=Accuracy(goals=["foot.force"]),
        table=[Amplitude(name=name, points=points) for name, points in tables.items()],
    )  # fmt: skip
    return scenes.load(scene, **keys)


@lru_cache
def force_of_foot(steps):
    """Return the force on the foot after steps of the same length."""
    return np.array(solve(turned_foot(steps)).steps[-1]["obstacles"]["foot"]["force"])


@pytest.mark.one_debian
@pytest.mark.parametrize("petsc", [{}, {"snes_max_it": 4}])
def test_the_error_of_the_load_steps(petsc, monkeypatch):
    """Friction follows a turn by chords: a quarter of the force with four steps of it.

    With few Newton iterations 8 steps are 10, and 4 are 6; with stiffer penalties no path is found,
    and a line says so.
    """
    if petsc:  # steps that fail are halved, in place of being solved again in another way
        monkeypatch.setattr("fem_snh.steps.stepping.StepSolver.can_rescue", False)
    result = solve(turned_foot(8, error=True, petsc=petsc))
    force = np.array(result.steps[-1]["obstacles"]["foot"]["force"])
    assert sum(row["converged"] for row in result.steps) == (10 if petsc else 8)
    goals = result.estimate.goals
    exact = 2 * force_of_foot(32) - force_of_foot(16)
    for axis, value, true in zip("xy", force, exact, strict=False):
        part = goals[f"foot.force.{axis}"].parts["load steps"]
        assert abs(true - value) > 0.1 * np.linalg.norm(exact[:2])
        assert 0.6 < part / (true - value) < 1.4
    lines = [line for line in result.estimate.left_out if "the error of penalties is not" in line]
    assert len(lines) == bool(petsc)


@mpi
def test_ranks_have_the_same_estimate(comm):
    scene = scenes.load("seal", cells=4, steps=2, squeeze=0.1, error=True)
    shared, alone = (solve(scene, ranks).estimate.goals[FORCE] for ranks in (comm, MPI.COMM_SELF))
    assert alone.parts.keys() == shared.parts.keys() and alone.parts
    for name, part in alone.parts.items():
        assert shared.parts[name] == pytest.approx(part, rel=1e-4, abs=1e-4), name


def test_parts_that_cancel_are_no_estimate():
    """Of one level: an error whose parts may miss more than their sum is shown as a bound."""
    parts = {"mesh": 0.025, "penalty": -0.028}
    missed = {source: 0.5 * abs(part) for source, part in parts.items()}
    goal = GoalError(-1.0, sum(parts.values()), scale=1.0, parts=parts, missed=missed)
    assert goal.text("tip.z") == "tip.z -1, estimated error below 3.0 %"
