"""Contact between bodies of two dimensions: patch test, derivatives, momentum."""

from __future__ import annotations

from math import pi

from mpi4py import MPI

import numpy as np
import pytest
from barrier_problems import needs_ipctk
from derivatives import check_derivatives
from gmsh_files import section
from plane_scenes import solve
from rectangles import rectangle

import fem_snh

FLAT = ("plane_strain", "axisymmetric")


def blocks(path, triangles, order, gap=0.0):
    """Two rectangles, 3 and 4 cells wide, one above the other at a distance."""
    with section(path, order) as (geo, groups, bodies):
        blocks = ((0.0, ("bottom", "under"), 3), (0.5 + gap, ("over", "top"), 4))
        for number, (low, names, count) in enumerate(blocks):
            lines, surface = rectangle(geo, (0, low), (1, low + 0.5), (count, 2), triangles)
            groups |= {names[0]: [lines[0]], names[1]: [lines[2]]}
            groups.setdefault("axis", []).append(lines[3])
            bodies[f"block_{number}"] = [surface]


SCENE = """
mesh = "blocks.msh"
element = "{element}"
kinematics = "{kinematics}"
material = {{ name = "stable_neo_hookean", E = 1.0, nu = {nu} }}
contact = [{{ groups = ["under", "over"], method = "{method}" }}]
hold = [{{ group = "bottom", components = ["y"] }}, {{ group = "axis", components = ["x"] }}]
move = [{{ group = "top", translate = [0, -0.1, 0], components = ["y"] }}]
"""


def scene(folder, element, triangles, **values):
    blocks(folder / "blocks.msh", triangles, int(element[1]))
    (folder / "own.toml").write_text(SCENE.format(element=element, **values))
    return folder / "own.toml"


def check_near(problem, height, width, noise, *bounds, begin=False):
    """Check the derivatives by unknowns near a height, at a state that is moved by noise."""
    problem.x.array[:] += np.random.default_rng(0).uniform(-noise, noise, len(problem.x.array))
    if begin:
        problem.terms[1].begin_step(problem.split(problem.x)[0])
    near = abs(problem.coordinates[:, 1] - height) < width
    dofs = (2 * np.flatnonzero(near)[:, None] + [0, 1]).ravel()
    check_derivatives(problem, dofs, 1e-7, *bounds, constrained=False)


def median_pressure(problem):
    found = problem.terms[1].nodal_field("contact_pressure", problem.split(problem.x)[0])
    return np.median(found[found > 0])


def pressure(stretch):
    """Return the stress of the blocks, which do not expand sideways."""
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.0)
    return -material.pk1(np.diag([1.0, stretch, 1.0]))[1, 1]


@pytest.mark.one_debian("serial")
@pytest.mark.mpi
@pytest.mark.parametrize("method", ["penalty", "augmented_lagrangian"])
@pytest.mark.parametrize("element, triangles", [("Q1", False), ("P2", True)])
@pytest.mark.parametrize("kinematics", FLAT)
def test_patch(comm, folder, kinematics, element, triangles, method):
    """Blocks with other cells on both sides have a uniform pressure, in two passes."""
    if comm.rank == 0:
        scene(folder, element, triangles, kinematics=kinematics, nu=0.0, method=method)
    comm.barrier()
    result = solve(folder / "own.toml", comm)
    row = result.steps[-1]["contacts"]["under/over"]
    depth = row["penetration"]
    stretch = 1 - (0.1 - depth)
    area = 1.0 if kinematics == "plane_strain" else pi
    assert row["force"][1] == pytest.approx(-pressure(stretch) * area, rel=0.02)
    assert row["force"][2] == 0
    problem = result.problem
    y, u = problem.coordinates[:, 1], problem.nodal(problem.x)
    inside = y > 0.5 + 1e-9
    exact = -0.1 + (1 - stretch) * (1 - y)
    assert abs(u[inside, 1] - exact[inside]).max(initial=0) < 2e-3
    if method == "augmented_lagrangian":
        assert depth < 1e-3


@pytest.mark.one_debian
@pytest.mark.parametrize("kinematics", FLAT)
@pytest.mark.parametrize("element, triangles", [("Q1", False), ("P2", True), ("Q2", False)])
def test_residual_and_hessian_are_derivatives(tmp_path, kinematics, element, triangles):
    """At a deformed state with curved facets, by central differences."""
    values = {"kinematics": kinematics, "nu": 0.3, "method": "penalty"}
    problem = solve(scene(tmp_path, element, triangles, **values)).problem
    check_near(problem, 0.5, 1e-9, 5e-3, 5e-7, 1e-5, begin=True)


APART = """
mesh = "blocks.msh"
element = "{element}"
kinematics = "{kinematics}"
steps = 2
reactions = ["bottom"]
fields = ["contact_pressure"]
material = {{ name = "stable_neo_hookean", E = 1.0, nu = {nu} }}
hold = [{{ group = "bottom" }}]
move = [{{ group = "top", translate = [{slide}, -0.15, 0] }}]
self_contact.method = "{method}"
"""


def pressed(folder, element, method, kinematics, nu=0.3, slide=0.0, comm=MPI.COMM_SELF, **options):
    if comm.rank == 0:
        blocks(folder / "blocks.msh", element[0] == "P", int(element[1]), gap=0.05)
        values = {"kinematics": kinematics, "nu": nu, "slide": slide, "method": method}
        (folder / "own.toml").write_text(APART.format(element=element, **values))
    comm.barrier()
    return solve(folder / "own.toml", comm, **options)


@needs_ipctk
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_barrier_on_a_body_of_revolution(tmp_path, element):
    """The pressure of the compressed blocks, whose ends are free to slide, on the whole area."""
    result = pressed(tmp_path, element, "ipc", "axisymmetric", nu=0.0)
    row = result.steps[-1]
    contact = row["self_contact"]
    lower, upper = (np.array(force) for force in contact["bodies"])
    assert lower[1] == pytest.approx(-upper[1], rel=1e-12)
    assert row["reactions"]["bottom"][1] == pytest.approx(upper[1], rel=1e-4)
    P = pressure(1 - (0.15 - (0.05 - contact["distance"])))
    assert upper[1] == pytest.approx(P * pi, rel=0.02)
    assert median_pressure(result.problem) == pytest.approx(P, rel=0.2)


@pytest.mark.one_debian
@needs_ipctk
@pytest.mark.parametrize("kinematics", FLAT)
@pytest.mark.parametrize("element", ["Q1", "Q2"])
def test_barrier_has_derivatives(tmp_path, element, kinematics):
    """By central differences."""
    out = tmp_path / "out"
    problem = pressed(tmp_path, element, "ipc", kinematics, slide=0.02, out=out).problem
    check_near(problem, 0.525, 0.03, 1e-4, 1e-6, 1e-4)
    assert (out / "fields.pvd").is_file()


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("element", ["P1", "Q1P0", "P2", "Q2"])
@pytest.mark.parametrize("kinematics", FLAT)
def test_reference_method_between_two_blocks(comm, folder, kinematics, element):
    """The pressure of the compressed blocks, on the whole area, over the default stiffness."""
    row = pressed(folder, element, "reference", kinematics, nu=0.0, comm=comm).steps[-1]
    contact = row["self_contact"]
    depth = contact["penetration"]
    P = pressure(1 - (0.1 - depth))
    area = 1.0 if kinematics == "plane_strain" else pi
    assert 0 < depth < 4 * P / contact["stiffness"]  # the meshes do not match
    assert row["reactions"]["bottom"][1] == pytest.approx(P * area, rel=0.01)
    assert contact["force"] == pytest.approx(P * area, rel=0.01)


@pytest.mark.parametrize("kinematics", FLAT)
@pytest.mark.parametrize("element", ["P1", "Q2"])
def test_reference_method_has_derivatives(tmp_path, element, kinematics):
    """By central differences, and without a net force."""
    problem = pressed(tmp_path, element, "reference", kinematics).problem
    assert median_pressure(problem) == pytest.approx(0.12, rel=0.2)  # 0.1 E / (1 - nu^2)
    check_near(problem, 0.525, 0.03, 1e-4, 1e-6, 1e-4)
    r = problem.x.duplicate()
    problem.gradient(problem.x, r, problem.terms[1:])
    forces = problem.nodal(r)
    assert abs(forces).max() > 0.01
    assert abs(forces.sum(axis=0)).max() < 1e-12
