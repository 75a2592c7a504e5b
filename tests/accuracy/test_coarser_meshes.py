"""Errors of goals by the same scene on coarser meshes."""

from __future__ import annotations

import numpy as np
import pytest

import fem_snh
from benchmarks.accuracy_cases import stretch
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
