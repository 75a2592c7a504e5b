"""Supports without an area, points and in three dimensions edges: what carries a force is noted."""

from __future__ import annotations

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
    tables = {
        "name": "square", "mesh": square, "kinematics": "plane_strain", "element": "P2",
        "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
        "hold": [{"group": group, "components": list(axes)} for group, axes in hold.items()],
        "traction": [{"group": group, "vector": [0, f, 0]} for group, f in loads.items()],
    }  # fmt: skip
    return validate(tables | keys, "scene")


def supports(result: Any) -> list[dict[str, Any]]:
    return [note for note in result.notes if note["kind"] == "supports"]


def test_corners_that_carry_a_load(comm: Any, square: Any) -> None:
    """Finer cells give way further, as the logarithm of their size: two levels, and no more."""
    accuracy = {"within": 0.01, "goals": ["energy", "top.mean.y"], "max_dofs": 1000000}
    carried = scene(square, {"corners": "xy"}, {"top": -0.1}, accuracy=accuracy)
    result = solve(carried, comm)
    (note,) = supports(result)
    words = "[[hold]] of 'corners': points and edges have no area, and carry"
    assert note["text"].startswith(words)
    # Two equal vertical forces, and horizontal ones that add no net force.
    assert note["force"] > 0.1 / 2**0.5
    record = result.record["accuracy"]
    assert not record["reached"] and len(record["levels"]) == 2
    assert record["limit"] == note["text"]


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


def fixed(V: Any, axis: int, value: float = 0.0) -> Any:
    """Return the condition of a displacement on the side at 0 of an axis."""
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[axis], 0.0))
    return fem.dirichletbc(np.full(2, value), dofs, V)


@pytest.mark.filterwarnings("ignore")
def test_conditions_of_a_program_that_contradict(comm: Any) -> None:
    """At the corner; a condition that replaces another one everywhere is none."""
    V = vector_space(mesh.create_unit_square(comm, 3, 3), 2, 2)
    snh = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    notes = []
    for axis in (0, 1):
        bcs = [fixed(V, 1), fixed(V, axis, 0.01)]
        problem = fem_snh.NonlinearProblem(
            fem.Function(V), {snh: ufl.dx}, bcs=bcs, kinematics="plane_strain"
        )
        problem.solve()
        assert problem.solver.getConvergedReason() > 0
        notes.append(problem.notes)
    (note,) = notes[0]
    assert note.kind == "load" and notes[1] == []
    words = "bcs[0] and bcs[1] prescribe other values of x, y at 1 common nodes"
    assert note.text.startswith(words)
