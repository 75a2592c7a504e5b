"""``error = "coarser"``: the errors of a run by two coarser ones alone."""

from __future__ import annotations

from typing import Any

import pytest
from interrupted_runs import cut
from running import solve

import fem_snh
from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.scenes import Scene, Time, load

#: The corner's displacement with 64 cells of Q2Q1, extrapolated (docs/howto/error.md).
EXACT = {"corner.y": 6.925, "corner.x": -5.814}


def membrane(cells: int, error: Any, **keys: Any) -> Scene:
    scene = load("cook", kinematics="plane_strain", element="Q1P0", cells=cells, steps=1)
    return scene.model_copy(update={"error": error, **keys})


@pytest.mark.mpi
def test_the_errors_are_differences_to_the_corrected_values_of_a_coarser_run(comm: Any) -> None:
    fine, coarse = (solve(membrane(*how), comm) for how in ((16, "coarser"), (8, True)))
    assert fine.estimate.dofs == coarse.estimate.dofs < fine.problem.dofs * 2
    for name, goal in fine.estimate.goals.items():
        known = coarse.estimate.goals[name]
        rounding = 1e-12 * known.scale
        assert goal.corrected == pytest.approx(known.corrected, rel=1e-9, abs=rounding)
        assert goal.bound >= known.bound * (1 - 1e-9)
        assert goal.value != known.value or not known.estimate
    for name, exact in EXACT.items():
        goal = fine.estimate.goals[name]
        assert abs(goal.corrected - exact) < goal.bound
    assert fine.estimate.indicators == {}


def test_in_time_each_goal_is_that_of_its_time() -> None:
    scene = membrane(8, "coarser")
    update = {
        "time": Time(duration=0.2, steps=16),
        "accuracy": scenes.Accuracy(goals=[{"name": "corner.y", "at": 0.1}]),
        "material": [each.model_copy(update={"density": 1e-3}) for each in scene.materials],
    }
    scene = scene.model_copy(update=update)
    found = solve(scene)
    goal, known = found.estimate.goals["corner.y"], solve(scene.model_copy(update={"error": True}))
    assert found.estimate.loads["corner.y"] == 0.5
    assert goal.value == pytest.approx(known.estimate.goals["corner.y"].value, rel=1e-9)
    assert abs(goal.corrected - known.estimate.goals["corner.y"].corrected) < goal.bound


def test_a_resumed_run_has_no_curve(tmp_path: Any) -> None:
    """Its rows are not those of the coarser run, which has one."""
    scene = membrane(8, "coarser", steps=3)
    with cut(2):
        fem_snh.run(scene, out=tmp_path, progress=False)
    result = fem_snh.run(scene, out=tmp_path, resume=True, progress=False)
    assert result.converged and result.estimate.curves == {}
    last = result.goals["corner.y"]
    assert [row.get("goals", {}).get("corner.y") for row in result.steps] == [
        None,
        None,
        last["value"],
    ]


@pytest.mark.parametrize("error", [True, "coarser"])
def test_a_bone_that_is_a_shape_has_no_estimate(error: Any) -> None:
    """The shape ends at the last of its nodes, which another element does not show."""
    cube = Scene.model_validate(
        {
            "name": "cube", "mesh": {"source": "cube"}, "cells": 4, "element": "Q1", "steps": 1,
            "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
            "hold": [{"group": "bottom"}], "move": [{"group": "top", "translate": [0.01, 0, 0]}],
            "bone": [{"name": "core", "shape": {"sphere": {"center": [0.5] * 3, "radius": 0.3}}}],
            "error": error,
        }
    )  # fmt: skip
    estimate = solve(cube).estimate
    assert "is a shape, which ends at the last of its nodes" in estimate.reason


def test_a_mesh_of_which_none_is_coarser() -> None:
    estimate = solve(membrane(1, "coarser")).estimate
    assert estimate.reason == "no mesh has fewer than 1 cells along an edge"
    with pytest.raises(BadInput, match="error = 'finer': expected true, false or 'coarser'"):
        load("cook", error="finer")
