"""The estimate of the error in a dolfinx program: the same as of a scene; its goals."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from bodies import PRESS
from dolfinx import fem
from dolfinx_programs import Bar, Press, converged, tagged_measure, unit_cube, vector_space
from running import solve

import fem_snh
from fem_snh import _dolfinx
from fem_snh.scenes import Accuracy, MaterialChoice, Probe, Reaction
from fem_snh.terms.loads import Traction

SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)
POINT = (1.0, 0.25, 0.5)


@pytest.mark.mpi
def test_a_program_has_the_errors_of_its_scene(comm):
    named = ["side", "top.force", "top.moment", "right.mean", "energy", "volume", "stress"]
    update = {
        "material": MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.49), "error": True,
        "probe": [Probe(name="side", point=POINT, radius=0.3)],
        "reactions": [Reaction("top", (0, 0, -1))],
        "accuracy": Accuracy(goals=[*named, "side.stress"]),
    }  # fmt: skip
    of_scene = solve(PRESS.model_copy(update=update), comm=comm)
    body = Press(of_scene.problem.domain, height=-0.5)
    problem = fem_snh.NonlinearProblem(body.u, {SNH: ufl.dx}, bcs=body.bcs)
    problem.solve()
    assert converged(problem)
    before = body.u.x.array.copy()
    goals = {"side": POINT, "top.force": body.bcs[1], "energy": "energy", "volume": "volume"}
    goals |= {"top.moment": (body.bcs[1], (0, 0, -1)), "stress": (ufl.dx, "stress")}
    goals["side.stress"] = (POINT, "stress", 0.3)
    goals["right.mean"] = tagged_measure("ds", body.domain, [lambda x: np.isclose(x[0], 1)])(1)
    found = problem.estimate_error(goals)
    assert found.reason == ""
    assert (body.u.x.array == before).all()
    assert found.goals.keys() == of_scene.goals.keys()
    for name, goal in found.goals.items():
        other = of_scene.goals[name]
        assert goal.value == pytest.approx(other["value"], rel=1e-5, abs=1e-6)
        assert goal.error == pytest.approx(other["error"], rel=0.02, abs=1e-5)


@pytest.mark.one_debian("ranks")
@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_a_stretched_bar_has_no_error(comm, cell):
    """A homogeneous state between rollers, which constrain components of faces."""
    body = Bar(unit_cube(comm, 2, cell))
    problem = fem_snh.NonlinearProblem(body.u, {SNH: ufl.dx}, bcs=body.bcs)
    problem.solve()
    stretch = body.F[0, 0] * ufl.dx
    found = problem.estimate_error([(1, 1, 1), body.bcs[3], stretch, ufl.dx, "energy"])
    assert found.reason == ""
    assert list(found.goals)[:6] == [
        "(1, 1, 1).x", "(1, 1, 1).y", "(1, 1, 1).z",
        "bcs[3].force.x", "bcs[3].force.y", "bcs[3].force.z",
    ]  # fmt: skip
    assert found.goals["goals[2]"].value == pytest.approx(1.5)
    assert found.goals["mean 3.x"].value == pytest.approx(0.25)
    for name, goal in found.goals.items():
        assert abs(goal.error) < 1e-5, name


@pytest.mark.mpi
def test_a_plane_inside_of_a_body_is_constrained_in_the_lifted_element(comm):
    """With a condition that is named twice: the corrected energy is that of degree 2."""
    energies, soft = [], fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    for degree in (1, 2):
        V = vector_space(unit_cube(comm, 2), degree)
        z, moved = V.tabulate_dof_coordinates()[:, 2], fem.Function(V)
        moved.x.array[0::3] = 0.2 * np.isclose(z, 0.5)
        planes = [np.flatnonzero(np.isclose(z, at)).astype(np.int32) for at in (0.0, 0.5)]
        bcs = [_dolfinx.prescribed(moved, nodes) for nodes in planes]
        problem = fem_snh.NonlinearProblem(fem.Function(V), {soft: ufl.dx}, bcs=[*bcs, bcs[1]])
        problem.solve()
        energies.append(problem.row["energy"])
        if degree == 1:
            found = problem.estimate_error(["energy"]).goals["energy"]
    assert found.value == energies[0]
    assert found.corrected == pytest.approx(energies[1], rel=1e-6)


@pytest.mark.mpi
@pytest.mark.parametrize("last", ["move", "dolfinx"])
def test_a_condition_that_another_one_overrides(comm, last):
    """A table and a condition of dolfinx on one face: the estimate is that of the last alone."""
    body = Press(unit_cube(comm, 2), height=-0.1)
    ds = tagged_measure("ds", body.domain, [lambda x: np.isclose(x[2], 1.0)])
    bottom, top = body.bcs
    moved = fem_snh.Move(group=ds(1), translate=[0, 0, 0.2])
    pair = [moved, top] if last == "dolfinx" else [top, moved]
    found = []
    for bcs in ([bottom, *pair], [bottom, pair[1]]):
        body.u.x.array[:] = 0.0
        problem = fem_snh.NonlinearProblem(body.u, {SNH: ufl.dx}, bcs=bcs)
        problem.solve()
        estimate = problem.estimate_error(["energy"])
        assert estimate.reason == ""
        found.append((estimate.goals["energy"].value, estimate.goals["energy"].error))
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_terms_are_carried_over(comm):
    """A dead load as a form and as a feature, and a spring as an energy: one estimate."""
    errors = []
    for kind in ("form", "feature"):
        body = Press(unit_cube(comm, 2))
        ds = ufl.Measure("ds", body.domain)
        load = fem.Constant(body.domain, np.array([0.05, 0.0, 0.0]))
        spring = 0.01 * ufl.inner(body.u, body.u) * ds
        form = -ufl.inner(load, ufl.TestFunction(body.V)) * ds
        dead = form if kind == "form" else Traction(group=ds, vector=(0.05, 0, 0))
        problem = fem_snh.NonlinearProblem(
            body.u, {SNH: ufl.dx}, bcs=body.bcs[:1], terms=[dead, spring]
        )
        problem.solve()
        found = problem.estimate_error({"corner": (1, 1, 1)})
        errors.append(found.goals["corner.x"].error)
        assert found.goals["corner.x"].relative > 0.01
    assert errors[0] == pytest.approx(errors[1], rel=1e-3)
