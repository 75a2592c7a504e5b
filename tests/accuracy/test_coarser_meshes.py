"""Errors of goals by the same scene on coarser meshes."""

from __future__ import annotations

import numpy as np
import pytest

import fem_snh
from benchmarks.accuracy_cases import exact, stretch
from fem_snh.accuracy.coarser_meshes import extrapolated, with_error
from fem_snh.accuracy.goal_errors import GoalError
from fem_snh.errors import BadInput
from fem_snh.scenes import Lattice, Scene

_BY_MESHES = {"estimate": "coarser_meshes"}


def run(scene, **keys):
    """Return the result of a scene with an estimate by coarser meshes."""
    given = {"progress": False, "accuracy": _BY_MESHES, **keys}
    return fem_snh.run(scene, **given)


@pytest.mark.parametrize("fineness", [(16.0, 8.0, 4.0), (15.0, 8.0, 4.0), (1.0, 0.5, 0.25)])
@pytest.mark.parametrize("order", [0.9, 1.0, 1.7, 2.0, 3.3, 4.0])
def test_errors_of_any_order_are_found(fineness, order):
    errors = np.outer([n**-order for n in fineness], [2.0, -0.3])
    change, before = errors[1] - errors[0], errors[2] - errors[1]
    found, bounds = extrapolated(change, before, fineness, degree=2)
    np.testing.assert_allclose(found, errors[0], rtol=1e-3)
    assert (bounds >= abs(errors[0])).all()


def test_the_error_of_numbers_on_three_meshes():
    """Cook's membrane with Q1, nu = 0.3 (deal.II code gallery), where Q2 converges to 14.74."""
    tip = fem_snh.error_from_meshes([13.86, 14.49, 14.67], [8, 16, 32], degree=1)
    assert (
        tip.text("tip.y")
        == "tip.y 14.6700, error +0.072 (0.49 %), at most 2.1 %, corrected 14.7420"
    )
    for values, cells in (([1, 2], [1, 2, 4]), ([1, 2, 3], [4, 2, 1]), ([1, 2, np.nan], [1, 2, 3])):
        with pytest.raises(BadInput, match="expected three"):
            fem_snh.error_from_meshes(values, cells, 1)


def test_changes_without_an_order_have_a_bound_or_none():
    change, before = np.array([1.0, -1.0, 1.0, 1e-6]), np.array([1.5, 8.0, 0.9, 0.0])
    errors, bounds = extrapolated(change, before, (4.0, 2.0, 1.0), 1, rounding=1e-5)
    assert errors[:3].tolist() == [0, 0, 0]
    assert bounds[:3].tolist() == [3.0, 16.0, np.inf]  # the third one may lock
    assert 0 < bounds[3] < 2e-6
    goal = with_error(GoalError(5.0, scale=5.0), errors[2], bounds[2], change[2])
    assert goal.text("x").startswith("x 5, no estimate: its changes do not decrease")


def test_an_element_that_locks_has_no_estimate():
    assert "Q1 locks" in run("cook", element="Q1", nu=0.4999, cells=16).estimate.reason


def test_the_error_of_a_polyhedron_is_included():
    """A lifted element has the same straight edges, and a line says so."""
    exact_force = 1.2895  # P2 with curved faces, 6, 8 and 12 cells: 1.2982, 1.2939, 1.2911
    scene = stretch(element="P1", cells=16, steps=3, nu=0.3)
    scene.mesh.parameters["order"] = 1
    found = run(scene)
    known = found.estimate.goals["right.force.x"]
    assert abs(exact_force - known.value) < known.at_most < 0.02 * exact_force
    lines = "\n".join([*found.estimate.lines(), *(note["text"] for note in found.notes)])
    assert "meshes with 8 and 4 cells" in lines
    assert "straight edges" not in lines


def test_an_order_that_is_high_by_chance_gives_a_bound_alone():
    """As of a polyhedron, whose errors of shape and element cancel in the last change.

    The changes are those of `right.force.x` of `stretch`, 12 cells of P2 with straight edges.
    """
    change, before = np.array([0.00029]), np.array([0.276])
    errors, bounds = extrapolated(change, before, (12.0, 6.0, 3.0), 2)
    goal = with_error(GoalError(0.9514, scale=0.95), errors[0], bounds[0], change[0])
    true = exact("stretch")[0] - goal.value
    assert 0.01 * abs(true) > abs(goal.error)
    assert abs(true) < goal.bound < 5 * abs(true)
    assert goal.text("force") == "force 0.9514, error below 2.4 %"


def test_penalties_by_default_are_stiffer_on_finer_cells():
    """With the default the estimate has the error of the penalty, 1 % of the force."""
    found = run("press", element="P2", cells=8, nu=0.3, to=0.8, steps=2)
    assert any("not that of a given stiffness" in line for line in found.estimate.lines())
    lifted = run("press", element="P2", cells=8, nu=0.3, to=0.8, steps=2, accuracy={})
    known, other = (r.estimate.goals["plate.force.z"] for r in (found, lifted))
    assert abs(other.parts["penalty"]) > 0.7 * abs(other.error)
    assert known.error / other.error == pytest.approx(1.0, abs=0.2)
    assert abs(other.error) < known.at_most


def test_lattices_are_coarser_as_well():
    ball = {"sphere": {"center": [0, 0, 0], "radius": 1.0}}
    scene = Scene(
        name="ball", element="Q1", mesh=Lattice(lattice=ball, cell=0.125), steps=1,
        material={"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3, "density": 1.0},
        gravity={"vector": [0, 0, -0.02]},
        bone=[{"name": "core", "shape": {"sphere": {"center": [0, 0, 0], "radius": 0.4}}}],
        probe=[{"name": "bottom", "point": [0, 0, -0.9]}],
    )  # fmt: skip
    found = run(scene)
    assert found.estimate.coarser == "lattices with cells of 0.25 and 0.5"
    assert found.estimate.goals["bottom.z"].bound is not None


@pytest.mark.mpi
def test_goals_do_not_depend_on_ranks(comm):
    known = run("cook", element="Q2", cells=8, nu=0.3, comm=comm).estimate.goals["corner.y"]
    alone = run("cook", element="Q2", cells=8, nu=0.3, comm=comm.Split(comm.rank))
    other = alone.estimate.goals["corner.y"]
    assert known.error == pytest.approx(other.error, rel=1e-6)
    assert known.at_most == pytest.approx(other.at_most, rel=1e-6)


def test_too_little_memory_for_the_lifted_element():
    found = run("cook", element="Q2", cells=8, nu=0.3, accuracy={"max_memory": 0.5})
    assert found.estimate.coarser and not found.estimate.reason
    (line,) = found.estimate.left_out
    assert "4 and 2 cells along an edge, as Q3 needs about" in line
    assert "0.5 MB are allowed" in line
    record = found.record["goals"]["corner.y"]
    assert record["bound"] == found.estimate.goals["corner.y"].at_most
    plenty = run("cook", element="Q2", cells=8, nu=0.3, accuracy={"max_memory": 500})
    assert not plenty.estimate.coarser


def test_too_few_cells():
    text = "in place of {} cells along an edge coarser meshes would have {} and {}, as the geometry"
    reason = run("cook", element="Q1", cells=8, nu=0.3).estimate.reason
    assert reason.startswith(text.format(8, 4, 2)) and reason.endswith("two meshes, and 4 or more")
    reason = run("elbow", cells=16, steps=1, angle=5).estimate.reason
    assert reason.startswith(text.format(16, 12, 12))


def test_a_resumed_run_gets_the_other_estimate(tmp_path):
    keys = {"element": "Q2", "cells": 8, "nu": 0.3, "out": tmp_path / "out"}
    run("cook", **keys)
    again = run("cook", **keys, resume=True, accuracy={})
    assert "coarser" not in again.record["estimate"] and again.record["goals"]["corner.y"]["error"]
    once_more = run("cook", **keys, resume=True)
    assert "4 and 2 cells" in once_more.record["estimate"]["coarser"]


def test_where_meshes_are_not_coarsened(toml):
    accepted = "expected lifted_element, "
    with pytest.raises(BadInput, match=f"{accepted}as the mesh of a file"):
        run(toml)
    with pytest.raises(BadInput, match=f"{accepted}as accuracy.within"):
        run("cook", accuracy=_BY_MESHES | {"within": 0.01})
    with pytest.raises(BadInput, match="coarser_meshes"):
        run("cook", accuracy={"estimate": "coarser_mesh"})
