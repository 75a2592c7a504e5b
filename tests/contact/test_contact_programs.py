"""Obstacles and contact of two surfaces as terms of a dolfinx program: as in a scene."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from contact_programs import TIGHT, program, surface
from contact_scenes import PLATE, slide
from running import solve

import fem_snh
from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.mesh import mesh

pytestmark = pytest.mark.mpi


@pytest.mark.one_debian
def test_an_obstacle_with_friction_on_a_group(comm):
    expected = solve(slide(group="top"), comm=comm).steps[-1]
    body = mesh.generate(comm, "cube", "hexahedron", cells=2)
    plate = fem_snh.Obstacle(**PLATE, group=surface(body, "top")[0])
    *_, row = program(body, {"bottom": 0.0}, plate).steps(4)
    assert row["converged"] and row["load"] == 1.0
    found, wanted = row["obstacles"]["plate"], expected["obstacles"]["plate"]
    np.testing.assert_allclose(found["force"], wanted["force"], rtol=1e-5, atol=1e-8)
    assert found["contacts"] == wanted["contacts"] and found["sliding"] == wanted["sliding"]


@pytest.mark.one_debian
@pytest.mark.parametrize("method", ["penalty", "augmented_lagrangian"])
def test_two_blocks(comm, method):
    groups = ["lower_top", "upper_bottom"]
    table = {
        "name": "blocks", "mesh": {"source": "two_blocks", "parameters": {"upper_cells": 3}},
        "cells": 2, "element": "Q1",
        "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
        "hold": [{"group": "bottom"}], "move": [{"group": "top", "translate": [0, 0, -0.1]}],
        "contact": [{"groups": groups, "method": method}], "accuracy": {"goals": "energy"},
        "petsc": TIGHT,
    }  # fmt: skip
    result = solve(scenes.validate(table, "blocks"), comm=comm)
    expected = result.steps[-1]["contacts"]["lower_top/upper_bottom"]
    body = mesh.generate(comm, "two_blocks", "hexahedron", cells=2, upper_cells=3)
    contact = fem_snh.Contact(groups=surface(body, *groups), method=method)
    problem = program(body, {"bottom": 0.0, "top": -0.1}, contact)
    (row,) = problem.steps(1)
    found = row["contacts"]["ds(1)/ds(2)"]
    assert found["force"][2] < -0.05
    np.testing.assert_allclose(found["force"], expected["force"], rtol=1e-5, atol=1e-8)
    assert found["penetration"] == pytest.approx(expected["penetration"], rel=1e-5)
    estimate, parts = problem.estimate_error(["energy"]), result.goals["energy"]["parts"]
    assert estimate.goals["energy"].parts == pytest.approx(parts, rel=1e-3)
    assert ("load steps" in parts) == (method == "augmented_lagrangian")
    if method == "penalty":
        assert 0.002 < parts["penalty"] / row["energy"] < 0.2


def test_the_stiffness_of_contact_where_no_cell_has_a_material(comm):
    """A UFL energy has no Young's modulus, on which the default depends."""
    body = mesh.generate(comm, "cube", "hexahedron", cells=2)

    def solved(**keys):
        plate = fem_snh.Obstacle(**PLATE | keys, group=surface(body, "top")[0])
        *_, row = program(body, {"bottom": 0.0}, plate, energy=neo_hookean).steps(1)
        assert row["converged"]
        return row

    with pytest.raises(BadInput, match=r"obstacle 'plate': stiffness: expected a value \[Pa/m\]"):
        solved(stiffness=None)
    plate = solved(stiffness=20.0)["obstacles"]["plate"]
    assert plate["stiffness"] == pytest.approx(20.0)
    # Augmentations increase a soft one: without that there are 42 solves.
    assert solved(stiffness=0.2, method="augmented_lagrangian")["solves"] < 15


def neo_hookean(u):
    """An energy of a program's own."""
    F = ufl.Identity(3) + ufl.grad(u)
    return (ufl.inner(F, F) - 3) / 2 - ufl.ln(ufl.det(F)) + (ufl.det(F) - 1) ** 2 / 2
