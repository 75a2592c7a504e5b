"""Errors of bodies with rigid parts: goals of parts, their dual solutions, and the levels."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx_programs import converged, unit_cube
from rigid_bodies import HINGE_BETWEEN, bushing, bushing_mesh, corner_program
from running import solve

from fem_snh.mesh.mesh import centroid
from fem_snh.problem.duals import HessianSolver, Linearisation
from fem_snh.problem.goals import ReactionGoal, RigidGoal
from fem_snh.scenes import Accuracy, Geometry, Hold, MaterialChoice, Rigid, Scene
from fem_snh.terms.rigid import RESULTS

mpi = pytest.mark.mpi

TIGHT = {"snes_scaled_tol": 1e-13, "snes_linear_solver": "direct"}
FREE = [
    {"tag": 2, "spring": {"stiffness": 3e3, "rotation": 300.0}, "force": (0, 100, -150)},
    {"tag": 3, "joint": HINGE_BETWEEN | {"torque": 200.0}, "spring": {"rotation": 500.0}},
]
TURN = {"axis": (0, 0.6, 0.8), "angle": 0.4, "through": (0.8, 0.5, 0.8)}
MOVED = [
    {"tag": 2, "rotate": TURN, "free": ("x",)},
    {"tag": 3, "translate": (0, 0.1, -0.1), "free": ("rotation",)},
]


@mpi
@pytest.mark.parametrize("parts", [FREE, MOVED], ids=["free", "moved"])
def test_dual_solutions_are_derivatives_by_a_load(comm, parts):
    """A body force t f changes the gradient by t g, and a goal by -z . t g to first order."""
    force, h = np.array([700.0, -500.0, 300.0]), 1e-3
    goals = [RigidGoal(f"dx({tag})", kind) for tag in (2, 3) for kind in RESULTS]
    # A group of nodes of both parts, of which some are free and some are moved.
    about = (0.2, 0.1, 0.4)
    goals += [ReactionGoal("force", _upper), ReactionGoal("moment", _upper, about=about)]

    def state(t):
        program = corner_program(comm, parts, body_force=t * force, petsc_options=TIGHT)
        program.solve()
        assert converged(program)
        return program

    values = [
        np.array([value for goal in goals for value in goal.bind(program._problem)()])
        for program in (state(h), state(-h))
    ]
    derivative = (values[0] - values[1]) / (2 * h)
    program = state(0.0)
    problem = program._problem
    solver = HessianSolver(problem, program.solver.getKSP(), 1e-12)
    at = Linearisation(problem, problem.x, solver)
    g, without = problem.x.duplicate(), problem.x.duplicate()
    other = corner_program(comm, parts, body_force=force)._problem
    other.gradient(problem.x, g)
    problem.gradient(problem.x, without)
    g.axpy(-1.0, without)
    names = [name for goal in goals for name in goal.names]
    duals = at.solutions([goal.dual(at, i) for goal in goals for i in range(len(goal.names))])
    for name, found, z in zip(names, derivative, duals, strict=True):
        size = {"displacement": 1e-3, "rotation": 1e-3}.get(name.split(".")[-2], 1.0)
        assert -z.dot(g) == pytest.approx(found, rel=1e-4, abs=1e-5 * size), name


def _upper(problem):
    """Return the owned dofs of the nodes above z = 1/2."""
    return np.repeat(problem.coordinates[:, 2:] > 0.45, 3, axis=1)


@pytest.mark.parametrize(
    ("rigid", "goals"),
    [
        ({"torque": (0, 0, 3e5), "force": (1e5, 0, 0)}, ["displacement.x", "rotation.z"]),
        (
            {"rotate": {"axis": (0, 0, 1), "angle": 0.7, "through": (0.1, 0, 0)}},
            ["force.x", "force.y", "moment.z", "energy"],
        ),
    ],
    ids=["loaded", "moved"],
)
def test_estimate_is_the_error_against_a_finer_mesh(comm, tmp_path, rigid, goals):
    found, goals = [], [goal if goal == "energy" else f"sleeve.{goal}" for goal in goals]
    for around, layers in ((6, 4), (18, 12)):
        path = bushing_mesh(comm, tmp_path, around, layers)
        scene = bushing(path, rigid, accuracy=Accuracy(goals=goals), error=True)
        found.append(solve(scene).estimate)
    for name in goals:
        coarse, fine = (estimate.goals[name] for estimate in found)
        assert coarse.relative > 0.01
        assert coarse.error / (fine.corrected - coarse.value) == pytest.approx(1.0, abs=0.35), name
        # Cells have all of it, but for what is not linear.
        assert found[0].indicators[name].sum() == pytest.approx(coarse.error, rel=0.35), name


def grip(**keys):
    """Return a cube whose top is pulled and twisted."""
    return Scene(
        name="grip", mesh=Geometry(source="cube"), hold=[Hold(group="bottom")],
        material=MaterialChoice(name="stable_neo_hookean", E=1e4, nu=0.49),
        rigid=[Rigid(group="top", name="lid", force=(0, 0, 500), torque=(0, 0, 200))],
        **{"cells": 3, "element": "Q1P0"} | keys,
    )  # fmt: skip


@pytest.mark.one_debian
def test_levels_end_within_the_accuracy_and_see_no_jump(comm):
    goals = ["lid.rotation.z", "lid.displacement.z"]
    wanted = Accuracy(goals=goals, within=0.02, keep_element=True)
    result = solve(grip(accuracy=wanted))
    assert result.converged
    assert len(result.record["accuracy"]["levels"]) > 1
    assert not [note for note in result.notes if note["kind"] == "jump"]
    fine = solve(grip(cells=8, element="Q2Q1")).record["steps"][-1]["rigid"]["lid"]
    exact = {goals[0]: fine["rotation"][2], goals[1]: fine["position"][2] - 1.0}
    for name, value in exact.items():
        assert result.estimate.goals[name].corrected == pytest.approx(value, rel=0.02)


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_centroids_do_not_depend_on_the_mesh(comm, cell):
    """A corner of a distorted cube: its volume, its faces, and a face inside of the cube."""
    from dolfinx import mesh

    domain = unit_cube(comm, 4, cell)
    x = domain.geometry.x
    inside = 0.03 * np.sin(2 * np.pi * x[:, 0:1]) * np.sin(2 * np.pi * x[:, 1:2])
    x += inside * np.sin(2 * np.pi * x[:, 2:3])  # planes x = 1/2 stay plane
    upper = mesh.locate_entities(domain, 3, lambda x: x[0] > 0.5 - 1e-9)
    assert centroid(domain, 3, upper) == pytest.approx((0.75, 0.5, 0.5), abs=1e-9)
    for at in (0.0, 0.5):
        face = mesh.locate_entities(domain, 2, lambda x, at=at: np.isclose(x[0], at))
        assert centroid(domain, 2, face) == pytest.approx((at, 0.5, 0.5), abs=1e-12)
