"""What Newton's method leaves is a part of the error: loose tolerances are found and tightened."""

from __future__ import annotations

import numpy as np
import pytest
from running import solve

from fem_snh.scenes import Scene

GOALS = ["tip.y", "corner.x", "energy"]
#: Newton's tolerances: one that leaves percents of the displacement, and the default.
LOOSE, DEFAULT = 1e-2, 1e-7
#: The dead load on the top of a cube of steel [Pa].
SHEAR = 2e6


def cook(comm, tolerance, **keys):
    return solve(
        "cook", comm=comm, kinematics="plane_strain", element="Q1P0", cells=8, nu=0.49, steps=2,
        petsc={"snes_scaled_tol": tolerance}, **keys,
    )  # fmt: skip


@pytest.mark.one_debian
@pytest.mark.mpi
def test_the_parts_of_a_loose_solve_are_those_of_a_tight_one(comm):
    accuracy = {"goals": GOALS}
    loose, tight = (cook(comm, tol, error=True, accuracy=accuracy) for tol in (LOOSE, DEFAULT))
    assert tight.record["estimate"]["algebra"] < 1e-6
    assert loose.record["estimate"]["algebra"] > 1e-3
    for name in GOALS:
        found, exact = loose.goals[name], tight.goals[name]
        assert "parts" not in exact
        parts = found["parts"]
        assert sum(parts.values()) == pytest.approx(found["error"])
        left = exact["value"] - found["value"]
        assert abs(left) > 1e-3 * abs(exact["value"])
        assert parts["algebra"] == pytest.approx(left, rel=0.03)
        assert parts["mesh"] == pytest.approx(exact["error"], rel=0.01)
        assert found["corrected"] == pytest.approx(exact["corrected"], rel=1e-3)


@pytest.mark.one_debian
def test_the_estimate_does_not_change_the_run(comm):
    runs = [cook(comm, LOOSE, error=error) for error in (False, True)]
    energies = [run.steps[-1]["energy"] for run in runs]
    assert energies[0] == energies[1]
    assert (runs[0].problem.x.array == runs[1].problem.x.array).all()


def test_levels_tighten_the_tolerance(comm):
    fine = solve("cook", comm=comm, kinematics="plane_strain", element="Q2Q1", cells=16, nu=0.49)
    exact = fine.steps[-1]["probes"]["tip"][1]
    accuracy = {"goals": ["tip.y"], "within": 0.01, "keep_element": True}
    result = cook(comm, LOOSE, accuracy=accuracy)
    levels = result.record["accuracy"]["levels"]
    first, last = (levels[i]["goals"]["tip.y"] for i in (0, -1))
    assert abs(first["parts"]["algebra"]) > 0.01 * exact
    assert abs(last.get("parts", {}).get("algebra", 0.0)) < 0.0025 * exact
    assert result.record["accuracy"]["reached"]
    assert last["corrected"] == pytest.approx(exact, rel=0.01)


def sheared_cube(comm, **keys):
    """A cube of steel under a shear of 2 MPa, which is the force on its bottom."""
    scene = {
        "name": "sheared_cube", "mesh": {"source": "cube"}, "cells": 2, "element": "Q2",
        "material": {"name": "stable_neo_hookean", "E": 2e11, "nu": 0.3},
        "hold": [{"group": "bottom"}], "reactions": ["bottom"],
        "traction": [{"group": "top", "vector": [SHEAR, 0, 0]}],
    }  # fmt: skip
    return solve(Scene.model_validate(scene | keys), comm=comm)


@pytest.mark.mpi
def test_what_the_default_tolerance_leaves_is_measured(comm):
    result = sheared_cube(comm, error=True)
    left = np.abs(np.array(result.steps[-1]["reactions"]["bottom"]) - [-SHEAR, 0, 0]).max() / SHEAR
    assert left > 1e-8
    assert result.record["estimate"]["algebra"] == pytest.approx(left, rel=0.1)
