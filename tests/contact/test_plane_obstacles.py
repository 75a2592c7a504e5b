"""Obstacles of two dimensions: Hertz's line and point contact, patches, friction, momentum."""

from __future__ import annotations

from math import pi, sqrt

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from derivatives import check_derivatives
from gmsh_files import section
from plane_programs import COMPONENTS, displacement, prescribe, rectangle, zero
from plane_scenes import own_scene, solve, write_mesh

import fem_snh
from fem_snh import _dolfinx
from fem_snh.geometry.shapes import Polygon
from fem_snh.viewing.stored_run import obstacle_poses

mpi = pytest.mark.mpi
FLAT = ("plane_strain", "axisymmetric")
BALLS = [{"sphere": {"center": [x, -0.55, 0], "radius": 0.5}} for x in (0.2, 0.7)]
FLOOR = {"plane": {"point": [0, 0, 0], "normal": [0, 1, 0]}}


# --- Hertz ------------------------------------------------------------------------------------


def quarter_disc(path):
    """A quarter of a disc of radius 1 about (0, 1), fine at (0, 0); groups top and axis."""
    with section(path, 2) as (geo, curves, surfaces):
        geo.addPoint(0, 0, 0, 0.005, 1)
        geo.addPoint(0, 1, 0, 0.25, 2)
        geo.addPoint(1, 1, 0, 0.25, 3)
        geo.addPoint(np.sin(0.3), 1 - np.cos(0.3), 0, 0.015, 4)
        geo.addLine(1, 2, 1)
        geo.addLine(2, 3, 2)
        geo.addCircleArc(3, 2, 4, 3)
        geo.addCircleArc(4, 2, 1, 4)
        surfaces["body"] = [geo.addPlaneSurface([geo.addCurveLoop([1, 2, 3, 4])])]
        curves |= {"axis": [1], "top": [2]}


HERTZ = """
mesh = "disc.msh"
element = "P2"
kinematics = "{kinematics}"
fields = ["contact_pressure"]
material = {{ name = "stable_neo_hookean", E = 1.0, nu = 0.3 }}
hold = [{{ group = "axis", components = ["x"] }}]
move = [{{ group = "top", translate = [0, -{depth}, 0], components = ["y"] }}]
obstacle = [{{ shape = {{ plane = {{ normal = [0, 1, 0] }} }}, stiffness = 2e3 }}]
"""


def hertz(folder, kinematics, depth):
    quarter_disc(folder / "disc.msh")
    (folder / "hertz.toml").write_text(HERTZ.format(kinematics=kinematics, depth=depth))
    result = solve(folder / "hertz.toml")
    problem = result.problem
    pressure = problem.terms[1].nodal_field("contact_pressure", problem.split(problem.x)[0])
    x = problem.V.tabulate_dof_coordinates()
    on = x[:, 1] < 1 - np.sqrt(np.maximum(1 - x[:, 0] ** 2, 0)) + 1e-9
    on &= (0.006 < x[:, 0]) & (x[:, 0] < 0.3)  # at the corner half of the area is on the axis
    return result.steps[-1]["obstacles"]["obstacle_0"], x[on, 0], pressure[on]


@pytest.mark.one_debian
def test_hertz_line_contact(tmp_path):
    """The largest pressure and the half width of the force of a cylinder (Johnson 1985, 4.45)."""
    row, x, pressure = hertz(tmp_path, "plane_strain", 0.004)
    force, modulus = 2 * row["force"][1], 1 / (1 - 0.3**2)
    half_width = sqrt(4 * force / (pi * modulus))
    assert pressure.max() == pytest.approx(2 * force / (pi * half_width), rel=0.04)
    inside = x < 0.7 * half_width
    expected = 2 * force / (pi * half_width) * np.sqrt(1 - (x[inside] / half_width) ** 2)
    assert abs(pressure[inside] - expected).max() < 0.05 * pressure.max()
    touched = x[pressure > 1e-3 * pressure.max()].max()
    assert touched == pytest.approx(half_width, abs=0.02)
    assert np.allclose(row["force"][2], 0, atol=1e-15)


@pytest.mark.one_debian
def test_hertz_point_contact(tmp_path):
    """The force 4/3 E* sqrt(R) d^(3/2) of a ball, and the largest pressure 3 F/(2 pi a^2)."""
    depth = 0.004
    row, _, pressure = hertz(tmp_path, "axisymmetric", depth)
    force, modulus = row["force"][1], 1 / (1 - 0.3**2)
    # The middle plane of the ball moves: Hertz's approach is exact for small depths only.
    assert force == pytest.approx(4 / 3 * modulus * depth**1.5, rel=0.03)
    a = (3 * force / (4 * modulus)) ** (1 / 3)
    assert pressure.max() == pytest.approx(3 * force / (2 * pi * a**2), rel=0.05)


# --- patches ----------------------------------------------------------------------------------


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("method", ["penalty", "augmented_lagrangian"])
@pytest.mark.parametrize("element", ["Q1", "P2"])
@pytest.mark.parametrize("kinematics", FLAT)
def test_uniform_pressure(comm, kinematics, element, method):
    """A body pressed on a floor is compressed uniformly; the force is that of its area."""
    domain = rectangle(comm, element, (0.0, 0.0), (0.5, 1.0), (2, 3))
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.0)
    u = displacement(domain, element, kinematics)
    press = np.array([[0.0], [-0.1]])
    bcs = prescribe(u.function_space, 1, 1.0, lambda x: press, [1])
    bcs += prescribe(u.function_space, 0, 0.0, zero, [0])
    floor = fem_snh.Obstacle(shape=FLOOR, method=method)
    keys = {"bcs": bcs, "terms": [floor], "kinematics": kinematics, "element": element}
    (row,) = fem_snh.NonlinearProblem(u, {material: ufl.dx}, **keys).steps(1)
    assert row["converged"]
    values = u.x.array.reshape(-1, 2)
    contact = row["obstacles"]["obstacle_0"]
    depth = contact["penetration"]
    stretch = 0.9 + depth
    expected = -0.1 + (1 - stretch) * (1 - u.function_space.tabulate_dof_coordinates()[:, 1])
    assert abs(values[:, 1] - expected).max(initial=0) < 1e-7
    area = 0.5 if kinematics == "plane_strain" else pi / 4
    P = material.pk1(np.diag([1.0, stretch, 1.0]))[1, 1]
    assert abs(values[:, 0]).max(initial=0) < 0.05
    assert contact["force"][1] == pytest.approx(-P * area, rel=2e-2)
    if method == "augmented_lagrangian":
        assert depth < 1e-3


@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
@pytest.mark.parametrize("kinematics", COMPONENTS)
def test_the_pressure_is_that_of_the_deformed_surface(comm, kinematics, element):
    """Of a section that is 1.2 times as wide; its rotation about the axis changes no area."""
    domain = rectangle(comm, element, (0.2, 0.0), (0.8, 1.0), (3, 2))
    u = displacement(domain, element, kinematics)
    shape = {"plane": {"point": [0, 0.01, 0], "normal": [0, 1, 0]}}
    floor = fem_snh.Obstacle(shape=shape, stiffness=100.0)
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    made = fem_snh.NonlinearProblem(u, {material: ufl.dx}, terms=[floor], kinematics=kinematics)
    X = u.function_space.tabulate_dof_coordinates()
    values, stretch, angle = u.x.array.reshape(len(X), -1), 1.2, 0.4
    values[:, 0] = (stretch - 1) * X[:, 0]
    if kinematics == "axisymmetric_torsion":
        values[:, 0] = (stretch * np.cos(angle) - 1) * X[:, 0]
        values[:, 2] = stretch * np.sin(angle) * X[:, 0]
    inside = (X[:, 1] == 0) & (X[:, 0] > 0.35) & (X[:, 0] < 0.65)
    area = stretch if kinematics == "plane_strain" else stretch**2
    for name, expected in (("nominal_contact_pressure", 1.0), ("contact_pressure", 1 / area)):
        found = made._problem.terms[1].nodal_field(name, _dolfinx.petsc_vec(u))
        np.testing.assert_allclose(found[inside], expected, rtol=1e-10)


@pytest.mark.parametrize("kinematics", FLAT)
@pytest.mark.parametrize(
    "shape",
    [
        FLOOR,
        {"sphere": {"center": [0.3, -0.55, 0], "radius": 0.6}},
        {"capsule": {"from": [0.1, -0.4, 0], "to": [0.6, -0.5, 0], "radius": 0.5}},
        {"box": {"center": [0.5, -0.3, 0], "size": [0.6, 0.7, 0.1]}},
        {"polygon": {"points": [[0.0, -0.5], [0.9, -0.5], [0.9, 0.0], [0.5, 0.1], [0.2, 0.0]]}},
        {"smooth_union": {"shapes": BALLS, "blend": 0.1}},
    ],
)
def test_residual_and_hessian_are_derivatives(kinematics, shape):
    """By central differences, with friction in a step."""
    domain = rectangle(MPI.COMM_SELF, "Q2", (0.1, 0.0), (1.0, 0.5), (3, 2))
    u = displacement(domain, "Q2", kinematics)
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    obstacle = fem_snh.Obstacle(shape=shape, friction=0.3, translate=[0, 0.05, 0])
    made = fem_snh.NonlinearProblem(
        u, {material: ufl.dx}, terms=[obstacle], kinematics=kinematics
    )._problem
    made.set_load(0.5)
    made.prescribe(made.x)
    (term,) = made.terms[1:]
    made.x.array[1::2] = -0.02
    term.begin_step(made.split(made.x)[0])
    made.x.array[:] += np.random.default_rng(1).uniform(-0.003, 0.003, made.x.getLocalSize())
    assert term.energy(made.split(made.x)[0]) > 0
    bottom = np.flatnonzero(u.function_space.tabulate_dof_coordinates()[:, 1] < 1e-9)
    dofs = (2 * bottom[:, None] + [0, 1]).ravel()
    check_derivatives(made, dofs, 1e-7, 2e-7, 1e-4)


# --- shapes -----------------------------------------------------------------------------------


def test_polygon_is_its_distance():
    """By brute force on a fine boundary, a reentrant corner and both orientations included."""
    corners = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 0.4), (0.0, 1.0)]
    rng = np.random.default_rng(0)
    x = np.column_stack([rng.uniform(-1, 3, 300), rng.uniform(-1, 2, 300), rng.uniform(-9, 9, 300)])
    ends = np.roll(corners, -1, axis=0)
    t = np.linspace(0, 1, 4001)[:, None, None]
    boundary = (np.array(corners) * (1 - t) + ends * t).reshape(-1, 2)
    brute = np.array([np.linalg.norm(boundary - p[:2], axis=1).min() for p in x])
    below = np.where(x[:, 0] < 1, 1 - 0.6 * x[:, 0], 0.4 + 0.6 * (x[:, 0] - 1))
    inside = (x[:, 0] > 0) & (x[:, 0] < 2) & (x[:, 1] > 0) & (x[:, 1] < below)
    for points in (corners, corners[::-1]):
        found = Polygon(tuple(points)).evaluate(x)
        assert abs(abs(found.distance) - brute).max() < 1e-5
        assert ((found.distance < 0) == inside).all()
        h = 1e-6
        for i in range(2):
            step = np.eye(3)[i] * h
            high, low = (Polygon(tuple(points)).evaluate(x + s * step) for s in (1, -1))
            smooth = np.linalg.norm(high.gradient - low.gradient, axis=1) < 1e-3
            assert smooth.mean() > 0.9
            slope = (high.distance - low.distance) / (2 * h)
            assert abs(slope - found.gradient[:, i])[smooth].max() < 1e-6
            change = (high.gradient - low.gradient) / (2 * h)
            assert abs(change - found.hessian[:, i])[smooth].max() < 1e-4
    assert np.allclose(np.linalg.norm(found.gradient, axis=1), 1)


TWISTED = """
mesh = "mesh.msh"
element = "Q2"
kinematics = "axisymmetric_torsion"
steps = 8
reactions = [{ group = "bottom", about = [0, 0, 0] }]
material = { name = "stable_neo_hookean", E = 1.0, nu = 0.0 }
hold = [{ group = "bottom" }]
[[obstacle]]
name = "plate"
shape = { plane = { point = [0, 1, 0], normal = [0, -1, 0] } }
translate = [0, -0.1, 0]
rotate = { axis = [0, 1, 0], angle = 2.0 }
friction = 0.2
"""


def test_a_plate_turns_a_cylinder_by_friction(tmp_path):
    """It slides everywhere: the torque of a uniform pressure is 2/3 mu F R, with R = 1/2."""
    write_mesh(tmp_path / "mesh.msh", False, 1)
    (tmp_path / "own.toml").write_text(TWISTED)
    result = solve(tmp_path / "own.toml", out=tmp_path / "out")
    row = result.steps[-1]
    force, plate = row["reactions"]["bottom"][1], row["obstacles"]["plate"]
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.0)
    stretch = 0.9 + plate["penetration"]
    P = material.pk1(np.diag([1.0, stretch, 1.0]))[1, 1]
    assert force == pytest.approx(-P * pi / 4, rel=0.02)
    assert plate["force"][1] == pytest.approx(-force, rel=1e-6)
    assert row["moments"]["bottom"][1] == pytest.approx(-2 / 3 * 0.2 * force / 2, rel=0.02)
    assert (tmp_path / "out" / "obstacles.pvd").is_file()
    drawn = obstacle_poses(result.record, tmp_path)[0]["poses"][-1]
    assert np.allclose(drawn, [[1, 0, 0, 0], [0, 1, 0, -0.1], [0, 0, 1, 0]])


@pytest.mark.one_debian
def test_derivatives_under_torsion(tmp_path):
    """At a twisted state in a ring with friction, by central differences."""
    keys = """
[[obstacle]]
shape = { sphere = { center = [0.9, 0.5, 0], radius = 0.45 } }
rotate = { axis = [0, 1, 0], angle = 0.3 }
friction = 0.3
"""
    problem = solve(own_scene(tmp_path, "Q2", "axisymmetric_torsion", keys)).problem
    problem.x.array[:] += np.random.default_rng(0).uniform(-1e-3, 1e-3, len(problem.x.array))
    row = problem.terms[1].record(problem.split(problem.x)[0])
    assert row["obstacles"]["obstacle_0"]["contacts"]
    near = (problem.coordinates[:, 0] > 0.49) & (abs(problem.coordinates[:, 1] - 0.5) < 0.3)
    dofs = (3 * np.flatnonzero(near)[:, None] + [0, 1, 2]).ravel()
    check_derivatives(problem, dofs, 1e-7, 5e-6, 1e-4, constrained=False)
