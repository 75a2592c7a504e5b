"""Contact between bodies of two dimensions: patch test, derivatives, momentum."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from barrier_problems import needs_ipctk
from derivatives import check_derivatives
from gmsh_files import section
from plane_scenes import solve

import fem_snh

FLAT = ("plane_strain", "axisymmetric")


def blocks(path, triangles, order, gap=0.0):
    """Two rectangles, 3 and 4 cells wide, one above the other at a distance."""
    with section(path, order) as (geo, groups, bodies):
        blocks = ((0.0, ("bottom", "under"), 3), (0.5 + gap, ("over", "top"), 4))
        for number, (low, names, count) in enumerate(blocks):
            places = ((0, 0), (1, 0), (1, 0.5), (0, 0.5))
            corners = [geo.addPoint(x, low + y, 0) for x, y in places]
            lines = [geo.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
            surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
            for line, points in zip(lines, (count + 1, 3, count + 1, 3), strict=True):
                geo.mesh.setTransfiniteCurve(line, points)
            geo.mesh.setTransfiniteSurface(surface)
            if not triangles:
                geo.mesh.setRecombine(2, surface)
            groups |= {names[0]: [lines[0]], names[1]: [lines[2]]}
            groups.setdefault("axis", []).append(lines[3])
            bodies[f"block_{number}"] = [surface]


SCENE = """
mesh = "blocks.msh"
element = "{element}"
kinematics = "{kinematics}"
[material]
name = "stable_neo_hookean"
E = 1.0
nu = {nu}
density = 1.0
[[contact]]
groups = ["under", "over"]
"""
PRESS = """method = "{method}"
[[hold]]
group = "bottom"
components = ["y"]
[[hold]]
group = "axis"
components = ["x"]
[[move]]
group = "top"
translate = [0, -0.1, 0]
components = ["y"]
"""


@pytest.mark.one_debian("serial")
@pytest.mark.mpi
@pytest.mark.parametrize("method", ["penalty", "augmented_lagrangian"])
@pytest.mark.parametrize("element, triangles", [("Q1", False), ("P2", True)])
@pytest.mark.parametrize("kinematics", FLAT)
def test_patch(comm, folder, kinematics, element, triangles, method):
    """Blocks with other cells on both sides have a uniform pressure, in two passes."""
    if comm.rank == 0:
        blocks(folder / "blocks.msh", triangles, int(element[1]))
        text = SCENE.format(element=element, kinematics=kinematics, nu=0.0)
        (folder / "own.toml").write_text(text + PRESS.format(method=method))
    comm.barrier()
    result = solve(folder / "own.toml", comm)
    row = result.steps[-1]["contacts"]["under/over"]
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.0)
    depth = row["penetration"]
    stretch = 1 - (0.1 - depth)
    P = material.pk1(np.diag([1.0, stretch, 1.0]))[1, 1]
    area = 1.0 if kinematics == "plane_strain" else pi
    assert row["force"][1] == pytest.approx(P * area, rel=0.02)
    assert row["force"][2] == 0
    problem = result.problem
    y, u = problem.coordinates[:, 1], problem.nodal(problem.x)
    above = y > 0.5 + 1e-9
    inside = (abs(y - 0.5) > 1e-9) & above
    exact = -0.1 + (1 - stretch) * (1 - y)
    assert abs(u[inside, 1] - exact[inside]).max(initial=0) < 2e-3
    if method == "augmented_lagrangian":
        assert depth < 1e-3


@pytest.mark.one_debian
@pytest.mark.parametrize("kinematics", FLAT)
@pytest.mark.parametrize("element, triangles", [("Q1", False), ("P2", True), ("Q2", False)])
def test_residual_and_hessian_are_derivatives(tmp_path, kinematics, element, triangles):
    """At a deformed state with curved facets, by central differences."""
    blocks(tmp_path / "blocks.msh", triangles, int(element[1]))
    text = SCENE.format(element=element, kinematics=kinematics, nu=0.3)
    (tmp_path / "own.toml").write_text(text + PRESS.format(method="penalty"))
    problem = solve(tmp_path / "own.toml").problem
    term = next(t for t in problem.terms if t.name == "contact")
    rng = np.random.default_rng(0)
    problem.x.array[:] += rng.uniform(-5e-3, 5e-3, problem.x.getLocalSize())
    term.begin_step(problem.split(problem.x)[0])
    near = abs(problem.coordinates[:, 1] - 0.5) < 1e-9
    dofs = (2 * np.flatnonzero(near)[:, None] + [0, 1]).ravel()
    check_derivatives(problem, dofs, 1e-7, 5e-7, 1e-5, constrained=False)


BARRIER = """
mesh = "blocks.msh"
element = "{element}"
kinematics = "{kinematics}"
steps = 2
reactions = ["bottom"]
fields = ["contact_pressure"]
[material]
name = "stable_neo_hookean"
E = 1.0
nu = {nu}
[[hold]]
group = "bottom"
[[move]]
group = "top"
translate = [{slide}, -0.15, 0]
[self_contact]
"""
IPC = 'method = "ipc"'
REFERENCE = 'method = "reference"'


def pressed(
    folder,
    element,
    method=IPC,
    slide=0.0,
    comm=None,
    out=None,
    kinematics="plane_strain",
    nu=0.3,
    **changes,
):
    if comm is None or comm.rank == 0:
        blocks(folder / "blocks.msh", element[0] == "P", int(element[1]), gap=0.05)
        values = {"kinematics": kinematics, "nu": nu, "slide": slide}
        text = BARRIER.format(element=element, **values)
        (folder / "own.toml").write_text(text + method)
    if comm is not None:
        comm.barrier()
    return solve(folder / "own.toml", comm, **({"out": out} if out else {}), **changes)


@needs_ipctk
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_barrier_on_a_body_of_revolution(tmp_path, element):
    """The pressure of the compressed blocks, whose ends are free to slide, on the whole area."""
    result = pressed(tmp_path, element, kinematics="axisymmetric", nu=0.0)
    row = result.steps[-1]
    contact = row["self_contact"]
    lower, upper = (np.array(force) for force in contact["bodies"])
    assert lower[1] == pytest.approx(-upper[1], rel=1e-12)
    assert row["reactions"]["bottom"][1] == pytest.approx(upper[1], rel=1e-4)
    stretch = 1 - (0.15 - (0.05 - contact["distance"]))
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.0)
    P = material.pk1(np.diag([1.0, stretch, 1.0]))[1, 1]
    assert upper[1] == pytest.approx(-P * pi, rel=0.02)
    term = next(t for t in result.problem.terms if t.name == "self_contact")
    pressure = term.nodal_field("contact_pressure", result.problem.split(result.problem.x)[0])
    assert np.median(pressure[pressure > 0]) == pytest.approx(-P, rel=0.2)


@pytest.mark.one_debian
@needs_ipctk
@pytest.mark.parametrize("kinematics", FLAT)
@pytest.mark.parametrize("element", ["Q1", "Q2"])
def test_barrier_has_derivatives(tmp_path, element, kinematics):
    """By central differences."""
    problem = pressed(
        tmp_path, element, IPC, 0.02, out=tmp_path / "out", kinematics=kinematics
    ).problem
    rng = np.random.default_rng(0)
    problem.x.array[:] += rng.uniform(-1e-4, 1e-4, problem.x.getLocalSize())
    near = abs(problem.coordinates[:, 1] - 0.525) < 0.03
    dofs = (2 * np.flatnonzero(near)[:, None] + [0, 1]).ravel()
    check_derivatives(problem, dofs, 1e-7, 1e-6, 1e-4, constrained=False)
    assert (tmp_path / "out" / "fields.pvd").is_file()


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("element", ["P1", "Q1P0", "P2", "Q2"])
@pytest.mark.parametrize("kinematics", FLAT)
def test_reference_method_between_two_blocks(comm, folder, kinematics, element):
    """The pressure of the compressed blocks, on the whole area, over the default stiffness."""
    row = pressed(folder, element, REFERENCE, comm=comm, kinematics=kinematics, nu=0.0).steps[-1]
    contact = row["self_contact"]
    depth = contact["penetration"]
    stretch = 1 - (0.1 - depth)
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.0)
    P = -material.pk1(np.diag([1.0, stretch, 1.0]))[1, 1]
    area = 1.0 if kinematics == "plane_strain" else pi
    assert 0 < depth < 4 * P / contact["stiffness"]  # the meshes do not match
    assert row["reactions"]["bottom"][1] == pytest.approx(P * area, rel=0.01)
    assert contact["force"] == pytest.approx(P * area, rel=0.01)


@pytest.mark.parametrize("kinematics", FLAT)
@pytest.mark.parametrize("element", ["P1", "Q2"])
def test_reference_method_has_derivatives(tmp_path, element, kinematics):
    """By central differences, and without a net force."""
    problem = pressed(tmp_path, element, REFERENCE, kinematics=kinematics).problem
    term = next(t for t in problem.terms if t.name == "self_contact")
    pressure = term.nodal_field("contact_pressure", problem.split(problem.x)[0])
    assert np.median(pressure[pressure > 0]) == pytest.approx(0.12, rel=0.2)  # 0.1 E / (1 - nu^2)
    rng = np.random.default_rng(0)
    problem.x.array[:] += rng.uniform(-1e-4, 1e-4, problem.x.getLocalSize())
    near = abs(problem.coordinates[:, 1] - 0.525) < 0.03
    dofs = (2 * np.flatnonzero(near)[:, None] + [0, 1]).ravel()
    check_derivatives(problem, dofs, 1e-7, 1e-6, 1e-4, constrained=False)
    r = problem.x.duplicate()
    problem.gradient(problem.x, r, [term])
    forces = problem.nodal(r)
    assert abs(forces).max() > 0.01
    assert abs(forces.sum(axis=0)).max() < 1e-12


# A ring with a slot in its outer side, and a sector of it that is turned about the axis.
