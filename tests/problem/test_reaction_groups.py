"""Reactions of groups: each has the force of its own conditions, also at nodes that it shares."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import unit_cube, vector_space
from running import solve

import fem_snh

pytestmark = pytest.mark.mpi

#: A cube that is clamped at its left side and pulled at its right one, on a smooth floor.
CLAMPED: dict[str, Any] = {
    "cells": 3, "steps": 1, "nu": 0.3, "move": [], "reactions": ["left", "bottom", "top"],
    "traction": [{"group": "right", "vector": [0.05, 0.02, 0.0]}],
}  # fmt: skip
FLOORS = [
    {"hold": [{"group": "left"}, {"group": "bottom", "components": ["z"]}]},
    {"hold": [{"group": "left"}], "symmetry": [{"group": "bottom"}]},
]


@pytest.mark.parametrize("floor", FLOORS, ids=["roller", "symmetry"])
def test_a_smooth_floor_has_no_friction(comm: Any, floor: dict[str, Any]) -> None:
    """At its edge with the clamped side it had 8 % of that side's force."""
    keys = CLAMPED | floor | {"accuracy": {"goals": ["bottom.force", "left.force.x"]}}
    result = solve(comm=comm, **keys)
    reactions = {name: np.array(force) for name, force in result.steps[-1]["reactions"].items()}
    assert reactions["left"] == pytest.approx([-0.05, -0.02, reactions["left"][2]], abs=1e-7)
    assert reactions["bottom"][:2] == pytest.approx([0, 0], abs=1e-15)
    assert abs(reactions["bottom"][2]) > 1e-3
    goals = result.goals
    for axis, force in zip("xyz", reactions["bottom"], strict=True):
        assert goals[f"bottom.force.{axis}"]["value"] == pytest.approx(force, abs=1e-12)
    # The top has no condition: its force is that of the nodes that it shares with the left side.
    notes = [note["text"] for note in result.notes if "reactions" in note["text"]]
    (note,) = [text for text in notes if "reactions of 'top'" in text]
    assert note.startswith("reactions of 'top': no condition is of this group, and others constra")
    assert "constrain 4 of its 16 nodes" in note and np.linalg.norm(reactions["top"]) > 1e-3


#: Of a cube: clamped at two faces with a common edge, with a corner of a roller, moved at a third.
CORNER: dict[str, Any] = {
    "cells": 3, "steps": 1, "nu": 0.3, "hold": [{"group": "left"}, {"group": "bottom"}], "move": [],
    "traction": [{"group": "right", "vector": [0.05, 0.02, 0.01]}],
}  # fmt: skip
PUSH = {"group": "top", "translate": [0, 0, -0.05], "components": ["x", "z"]}
SPHERE = {"sphere": {"center": [0, 0, 0.5], "radius": 0.4}}
ROLLER = {"group": "front", "components": ["y"]}
SHARED: dict[str, dict[str, Any]] = {
    "two clamped faces": {},
    "with a motion": {"move": [PUSH]},
    "and a roller": {"move": [PUSH], "hold": [*CORNER["hold"], ROLLER]},
    "a plane of symmetry": {"hold": [{"group": "left"}], "symmetry": [{"group": "bottom"}]},
    "a bone": {"bone": [{"name": "b", "shape": SPHERE}]},
}


def test_a_condition_of_a_program_has_what_no_later_one_sets(comm: Any) -> None:
    """The sum of both forces balances the load; on the common edge both had them."""
    domain = unit_cube(comm)
    V = vector_space(domain)
    u, bcs = fem.Function(V), []
    for axis in (0, 2):
        dofs = fem.locate_dofs_geometrical(V, lambda x, i=axis: np.isclose(x[i], 0))
        bcs.append(fem.dirichletbc(np.zeros(3), dofs, V))
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    load = ufl.dot(fem.Constant(domain, (0.05, 0.02, 0.01)), u) * ufl.dx
    problem = fem_snh.NonlinearProblem(u, {material: ufl.dx}, bcs=bcs, terms=[-load])
    problem.solve()
    left, bottom = (problem.reaction_force(bc) for bc in bcs)
    assert left + bottom == pytest.approx([-0.05, -0.02, -0.01], abs=1e-6)
    goals = problem.estimate_error({"left": bcs[0], "bottom": bcs[1]}).goals
    found = [goals[f"{name}.{axis}"].corrected for name in ("left", "bottom") for axis in "xyz"]
    total = np.array(found).reshape(2, 3).sum(axis=0)
    assert total == pytest.approx([-0.05, -0.02, -0.01], abs=1e-5)


@pytest.mark.parametrize("case", SHARED)
def test_the_reactions_of_all_groups_balance_the_loads(comm: Any, case: str) -> None:
    """What two groups constrain at common nodes counted for both: the sum missed the load by it."""
    keys = CORNER | SHARED[case]
    tables = [*keys["hold"], *keys["move"], *keys.get("symmetry", [])]
    names = ["body", *(table["group"] for table in tables)]
    groups = [{"group": name, "about": [0, 0, 0]} for name in names]
    result = solve(comm=comm, **keys, reactions=groups)
    row = result.steps[-1]
    force, moment = (np.array([row[key][n] for n in names]) for key in ("reactions", "moments"))
    bones = [bone["force"] for bone in row.get("bones", {}).values()]
    assert force[0] == pytest.approx([-0.05, -0.02, -0.01], abs=1e-6)
    assert np.sum([*force[1:], *bones], axis=0) == pytest.approx(force[0], abs=1e-7)
    if not bones:  # their moments are about a point of their own
        assert moment[1:].sum(axis=0) == pytest.approx(moment[0], abs=1e-7)
    notes = [note["text"] for note in result.notes if "reactions of" in note["text"]]
    assert notes
    if case == "two clamped faces":
        (note,) = notes
        assert note.startswith("reactions of 'left': its conditions and those of 'bottom' constr")
        assert "the same components at 4 nodes, whose force counts for the last one" in note
