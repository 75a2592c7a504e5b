"""The table [self_contact] with method = "ipc": runs, skins, mistakes."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from barrier_problems import needs_ipctk
from bodies import cube
from scipy.optimize import brentq
from scipy.sparse import random as random_matrix

import fem_snh
from fem_snh import _dolfinx
from fem_snh.contact.gathered_surface import EmbeddedSurface, SurfaceMatrix
from fem_snh.errors import BadInput
from fem_snh.scenes import validate
from fem_snh.viewing.states import States

#: A clip whose arms are pressed together: one body that touches itself.
CLIP = {
    "name": "clip", "mesh": {"source": "clip", "parameters": {"gap": 0.3, "arm": 2}},
    "cells": 1, "element": "P1", "steps": 6,
    "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.4},
    "hold": [{"group": "bottom"}], "move": [{"group": "upper_tip", "translate": [0, 0, -0.6]}],
    "self_contact": {"method": "ipc"},
}  # fmt: skip


@needs_ipctk
def test_a_body_touches_itself(tmp_path):
    names = ["nominal_contact_pressure", "contact_pressure"]
    result = fem_snh.run(validate(CLIP | {"fields": names}, "clip"), out=tmp_path / "clip")
    assert result.converged
    last = result.record["steps"][-1]["self_contact"]
    states = States(tmp_path / "clip" / "fields.pvd")
    first, final = (states.read(k).point_data for k in (0, len(states) - 1))
    nominal, true = (final[name] for name in names)
    assert not first[names[1]].any() and nominal.max() > last["force"] > 0
    # The areas of the compressed arms have changed by less than a fifth.
    assert true == pytest.approx(nominal, rel=0.2) and abs(true - nominal).max() > 1e-3
    assert last["pairs"] > 0 and last["force"] > 0.01 and 0 < last["distance"] < last["activation"]
    np.testing.assert_allclose(last["bodies"], 0, atol=1e-6 * last["force"])
    assert "self_contact" in result.record["terms"]
    header = (tmp_path / "clip" / "steps.csv").read_text().splitlines()[0]
    assert "self_contact.pairs" in header and "self_contact.bodies" not in header


@needs_ipctk
def test_the_error_of_the_gap():
    """Two blocks are one column once the gap is closed: a free uniaxial compression by a tenth."""
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)

    def stress(side):
        return material.pk1(np.diag([side, side, 0.9]))

    exact = stress(brentq(lambda side: stress(side)[0, 0], 1.0, 1.2))[2, 2]
    blocks = {
        "name": "blocks", "cells": 2, "element": "Q1",
        "mesh": {"source": "two_blocks", "parameters": {"upper_cells": 2, "gap": 0.01}},
        "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
        "symmetry": [{"group": group} for group in ("bottom", "left", "front")],
        "move": [{"group": "top", "components": ["z"], "translate": [0, 0, -0.21]}],
        "self_contact": {"method": "ipc"}, "accuracy": {"goals": ["top.force.z"]},
    }  # fmt: skip
    goal = fem_snh.run(validate(blocks, "blocks")).record["goals"]["top.force.z"]
    assert abs(goal["value"] / exact - 1) > 0.03
    assert goal["corrected"] == pytest.approx(exact, rel=5e-3)
    assert goal["parts"]["penalty"] == pytest.approx(exact - goal["value"], rel=0.1)


@needs_ipctk
def test_matrix_of_a_skin():
    """Points with weights: the blocks between nodes are those of W^T H W."""
    V = _dolfinx.function_space(cube(MPI.COMM_SELF, "hexahedron", 1).domain, 1, (3,))
    rng = np.random.default_rng(2)
    n, m = 5, 8
    nodes = np.array([rng.choice(m, 4, replace=False) for _ in range(n)])
    weights = rng.random((n, 4))
    triangles = np.array([[0, 1, 2], [2, 3, 4]])
    surface = EmbeddedSurface(V, rng.random((n, 3)), triangles, nodes, weights)
    W = np.zeros((n, m))
    np.put_along_axis(W, nodes, weights, axis=1)
    W = np.kron(W[:, surface.support.nodes], np.eye(3))
    H = random_matrix(3 * n, 3 * n, 0.5, "csc", random_state=3)
    matrix = SurfaceMatrix(surface)
    blocks = matrix.blocks(H)
    found = np.zeros((W.shape[1],) * 2).reshape(-1, 3, W.shape[1] // 3, 3)
    found[blocks.rows, :, blocks.columns] = blocks.values
    np.testing.assert_allclose(found.reshape(W.shape[1], -1), W.T @ H @ W, atol=1e-14)
    forces = rng.random((n, 3))
    np.testing.assert_allclose(surface.nodal(forces).ravel(), W.T @ forces.ravel(), atol=1e-14)
    assert not matrix.contains(blocks)
    matrix.replace(blocks)
    assert matrix.contains(blocks) and len(matrix.pairs) == len(blocks.rows)


@needs_ipctk
@pytest.mark.parametrize("gap, message", [
    (-0.1, "neither intersects nor touches itself in the mesh"), (0.0, "touches"),
])  # fmt: skip
def test_mesh_that_intersects_itself(gap, message):
    mesh = {"source": "two_blocks", "parameters": {"gap": gap, "upper_width": 0.6, "shift": 0.2}}
    table = CLIP | {"mesh": mesh, "move": [], "element": "Q1"}
    with pytest.raises(BadInput, match=message):
        fem_snh.run(validate(table, "scene"))


@needs_ipctk
def test_skins_of_a_lattice(tmp_path):
    """Two crossed rods of one lattice touch: the forces on their bones are those of contact."""
    low = {"capsule": {"from": [0, 0, 0], "to": [0.6, 0, 0], "radius": 0.2}}
    high = {"capsule": {"from": [0.3, -0.3, 0.5], "to": [0.3, 0.3, 0.5], "radius": 0.2}}
    bones = [
        {"name": name, "shape": {"capsule": rod["capsule"] | {"radius": 0.09}}, "translate": motion}
        for name, rod, motion in (("low", low, [0, 0, 0]), ("high", high, [0, 0, -0.16]))
    ]
    table = {
        "name": "rods", "mesh": {"lattice": {"union": [low, high]}, "cell": 0.1},
        "element": "Q1", "steps": 2, "material": CLIP["material"], "bone": bones,
        "self_contact": {"method": "ipc"},
    }  # fmt: skip
    result = fem_snh.run(validate(table, "scene"), out=tmp_path / "rods")
    assert result.converged
    last = result.record["steps"][-1]
    forces = np.array(last["self_contact"]["bodies"])
    np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-12)
    held = [last["bones"][name]["force"] for name in ("low", "high")]
    np.testing.assert_allclose(held, -forces, atol=1e-4 * abs(forces).max())
    assert abs(forces).max() > 1e-3
