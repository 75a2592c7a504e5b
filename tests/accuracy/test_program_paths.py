"""Errors in programs whose end depends on the path: it is followed again, as in a scene."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from contact_programs import MATERIAL, TIGHT, program, surface
from contact_scenes import PLATE, slide
from dolfinx import fem
from dolfinx_programs import vector_space
from running import solve

import fem_snh
from fem_snh import _dolfinx, scenes
from fem_snh.assembly.boundary_conditions import group_nodes
from fem_snh.mesh import mesh

mpi = pytest.mark.mpi


def cube(comm):
    return mesh.generate(comm, "cube", "hexahedron", cells=2)


@mpi
def test_friction_has_the_errors_of_the_scene(comm):
    scene = slide().model_copy(update={"predictor": "extrapolate"})
    goals = {"goals": ["plate.force", "energy"]}
    expected = solve(scenes.load(scene, accuracy=goals), comm=comm).estimate.goals
    obstacle = fem_snh.Obstacle(**PLATE)
    problem = program(cube(comm), {"bottom": 0.0}, obstacle)
    *_, row = problem.steps(4)
    before = problem.u.x.array.copy()
    estimate = problem.estimate_error([obstacle, "energy"])
    assert not estimate.reason
    np.testing.assert_array_equal(problem.u.x.array, before)
    forces = np.array([expected[f"plate.force.{axis}"].estimate for axis in "xyz"])
    assert abs(forces[2]) > 0.005 * abs(row["obstacles"]["plate"]["force"][2])
    for name, goal in expected.items():
        found, parts = estimate.goals[name].parts, goal.parts
        assert set(found) == {"load steps", "mesh", "penalty"}
        for part, value in found.items():
            size = np.abs(forces).max() if "force" in name else abs(goal.value)
            assert value == pytest.approx(parts[part], rel=1e-3, abs=1e-4 * size), (name, part)


def pressed(steps=2, cells=2):
    """Return a block between a rough floor and a top that moves, at the end of its steps.

    A function of the program sets the top's displacement and a traction in UFL.
    """
    body = mesh.generate(MPI.COMM_SELF, "cube", "hexahedron", cells=cells)
    V = vector_space(body.domain)
    u, top = fem.Function(V), fem.Function(V)
    nodes = group_nodes(V, body, "top")
    end = np.zeros_like(top.x.array.reshape(-1, 3))
    end[nodes] = (0.1, 0.0, -0.15)
    push = fem.Constant(body.domain, np.zeros(3))

    def set_load(load):
        top.x.array[:] = (load * end).ravel()
        push.value = (0.0, 0.02 * load, 0.0)

    shape = {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}
    floor = fem_snh.Obstacle(name="floor", shape=shape, friction=0.4)
    problem = fem_snh.NonlinearProblem(
        u, {MATERIAL: ufl.dx}, bcs=[_dolfinx.prescribed(top, nodes)],
        terms=[floor, -ufl.inner(push, u) * surface(body, "right")[0]],
        petsc_options=TIGHT, element="Q1P0",
    )  # fmt: skip
    *_, row = problem.steps(steps, set_load)
    return problem, floor, np.array(row["obstacles"]["floor"]["force"]), push


def test_values_that_a_function_sets_are_followed():
    """The steps' part is what twice as many change, in another program."""
    coarse = pressed(2)[2]
    problem, floor, force, push = pressed(4)
    estimate = problem.estimate_error([floor])
    np.testing.assert_allclose(push.value, (0, 0.02, 0))
    change, size = force - coarse, np.abs(force).max()
    assert np.abs(change).max() > 1e-4 * size
    for axis, exact in zip("xyz", change, strict=True):
        goal = estimate.goals[f"floor.force.{axis}"]
        assert goal.parts["load steps"] == pytest.approx(exact, abs=1e-6 * size)


@pytest.mark.parametrize("end", ["solve", "a second path", "half of a path"])
def test_paths_that_cannot_be_followed(comm, end):
    obstacle = fem_snh.Obstacle(**PLATE)
    problem = program(cube(comm), {"bottom": 0.0}, obstacle)
    if end == "solve":
        problem.solve()
    elif end == "a second path":
        for _ in range(2):
            list(problem.steps(2))
    else:
        next(problem.steps(2))
    estimate = problem.estimate_error([obstacle])
    wanted = "have not reached their end" if end == "half of a path" else "from its beginning"
    assert wanted in estimate.reason
    assert estimate.goals["plate.force.z"].error is None
