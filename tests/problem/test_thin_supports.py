"""Supports without an area, points and in three dimensions edges: what carries a force is noted."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import vector_space
from gmsh_files import write_msh
from running import solve

import fem_snh
from fem_snh.scenes import Scene, validate

pytestmark = pytest.mark.mpi

SQUARE = """
Rectangle(1) = {0, 0, 0, 1, 1}; MeshSize{:} = 0.12;
Physical Surface("body") = {1};
Physical Curve("bottom") = {1}; Physical Curve("top") = {3}; Physical Curve("left") = {4};
Physical Point("corner") = {1}; Physical Point("corners") = {1, 2};
"""


@pytest.fixture
def square(comm: Any, folder: Any) -> Any:
    return write_msh(comm, folder, 'SetFactory("OpenCASCADE");' + SQUARE, dim=2)


def scene(square: Any, hold: dict[str, str], loads: dict[str, float], **keys: Any) -> Scene:
    """Return a square of which the components of some groups are held."""
    return validate(
        {
            "name": "square",
            "mesh": square,
            "kinematics": "plane_strain",
            "element": "P2",
            "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
            "hold": [{"group": group, "components": list(axes)} for group, axes in hold.items()],
            "traction": [{"group": group, "vector": [0, f, 0]} for group, f in loads.items()],
        }
        | keys,
        "scene",
    )


def supports(result: Any) -> list[dict[str, Any]]:
    return [note for note in result.notes if note["kind"] == "supports"]


def test_corners_that_carry_a_load(comm: Any, square: Any) -> None:
    """Finer cells give way further, as the logarithm of their size: the levels end."""
    accuracy = {"within": 0.01, "goals": ["energy", "top.mean.y"], "max_dofs": 1000000}
    carried = scene(square, {"corners": "xy"}, {"top": -0.1}, accuracy=accuracy)
    result = solve(carried, comm)
    (note,) = supports(result)
    assert note["text"].startswith(
        "[[hold]] of 'corners': points and edges have no area, and carry"
    )
    # Two equal vertical forces, and horizontal ones that add no net force.
    assert note["force"] > 0.1 / 2**0.5
    record = result.record["accuracy"]
    assert not record["reached"] and len(record["levels"]) < 4
    assert record["limit"] == f"the errors do not decrease: {note['text']}"


@pytest.mark.one_debian
@pytest.mark.parametrize(
    ("hold", "loads"),
    [
        ({"corners": "y", "corner": "x"}, {"top": 0.1, "bottom": -0.1}),
        ({"bottom": "y", "corner": "x"}, {"top": -0.1}),
        ({"bottom": "xy", "corner": "xy"}, {"top": -0.1}),
    ],
)
def test_corners_that_prevent_rigid_motions(
    comm: Any, square: Any, hold: dict[str, str], loads: dict[str, float]
) -> None:
    assert not supports(solve(scene(square, hold, loads), comm))


@pytest.mark.one_debian
def test_the_axis_of_revolution_is_an_edge(comm: Any, square: Any) -> None:
    """A disc that hangs at its axis gives way without a limit; radially nothing moves there."""
    axial, radial = (
        solve(scene(square, hold, {"top": 1e-3}, kinematics="axisymmetric"), comm)
        for hold in ({"left": "y"}, {"left": "x", "bottom": "y"})
    )
    (note,) = supports(axial)
    assert note["text"].startswith("[[hold]] of 'left': points and edges have no area")
    assert not supports(radial)


def program(comm: Any, element: str, bcs: Any, load: float = -0.1) -> Any:
    """Return the solved program of a block with a traction on its top, and conditions."""
    dim = 3 if element == "Q1" else 2
    box, cell = mesh.create_rectangle, mesh.CellType.triangle
    if dim == 3:
        box, cell = mesh.create_box, mesh.CellType.hexahedron
    domain = box(comm, [np.zeros(dim), np.ones(dim)], [3] * dim, cell)
    V = vector_space(domain, int(element[1]), dim)
    facets = mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[dim - 1], 1))
    marks = np.ones(len(facets), dtype=np.int32)
    tags = mesh.meshtags(domain, dim - 1, np.sort(facets), marks)
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
    snh = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    found = fem_snh.NonlinearProblem(
        fem.Function(V),
        {snh: ufl.dx},
        bcs=bcs(V),
        terms=[fem_snh.Traction(ds(1), [0, 0, load] if dim == 3 else [0, load, 0])],
        kinematics=None if dim == 3 else "plane_strain",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found.solve()
    assert found.solver.getConvergedReason() > 0
    return found


def fixed(V: Any, where: Any, value: float = 0.0) -> Any:
    dofs = fem.locate_dofs_geometrical(V, where)
    values = np.full(V.mesh.geometry.dim, value)
    return fem.dirichletbc(values, dofs, V)


def at(**coordinates: float) -> Any:
    axes = {"xyz".index(axis): value for axis, value in coordinates.items()}
    return lambda x: np.all([np.isclose(x[i], value) for i, value in axes.items()], axis=0)


def test_conditions_of_a_program_that_contradict(comm: Any) -> None:
    """At the corner; a condition that replaces another one everywhere is none."""
    bottom, side = at(y=0.0), at(x=0.0)
    found = program(comm, "P2", lambda V: [fixed(V, bottom), fixed(V, side, 0.01)], 0.0)
    (note,) = found.notes
    assert note.kind == "load"
    words = "bcs[0] and bcs[1] prescribe other values of x, y at 1 common nodes"
    assert note.text.startswith(words)
    again = program(comm, "P2", lambda V: [fixed(V, bottom), fixed(V, bottom, 0.01)], 0.0)
    assert again.notes == []
