"""The scenes hand and torso on coarse lattices: convergence, volume, contact, nodes in bones."""

from __future__ import annotations

import numpy as np
import pytest
from running import solve

from fem_snh import scenes


def check_bones(result):
    """Check that the nodes of each bone are where its affine map has them."""
    problem = result.problem
    X = problem.coordinates
    u = problem.x.array_r[: 3 * len(X)].reshape(-1, 3)
    for bone in problem.dirichlet.bones:
        nodes, affine = bone.nodes[bone.nodes < len(u)], bone.affine(1.0)
        expected = X[nodes] @ affine[:, :3].T + affine[:, 3]
        assert np.abs(X[nodes] + u[nodes] - expected).max(initial=0.0) < 1e-12, bone.bone.name


@pytest.mark.mpi
def test_a_fist_with_noisy_bones():
    scene = scenes.load("hand", cells=36, contact=False, steps=4)
    assert len(scene.bone) == 24 and scene.rig.noise.amplitude == 0.05
    result = solve(scene)
    assert result.converged and all(step["converged"] for step in result.steps)
    assert result.record["cells"] == pytest.approx(1_500, rel=0.1)
    assert np.mean([step["newton"] for step in result.steps]) < 15.9
    assert max(step["residual"] for step in result.steps) <= 1e-2
    assert abs(result.steps[-1]["volume_ratio"] - 1) < 0.01
    check_bones(result)


@pytest.mark.mpi
def test_arms_that_touch_the_chest():
    result = solve(scenes.load("torso", cells=36, steps=4))
    assert result.converged and all(step["converged"] for step in result.steps)
    assert result.record["cells"] == pytest.approx(1_000, rel=0.1)
    assert np.mean([step["newton"] for step in result.steps]) < 13.7
    assert abs(result.steps[-1]["volume_ratio"] - 1) < 0.01
    contact = [step["self_contact"] for step in result.steps]
    assert contact[0]["pairs"] == 0 and contact[-1]["force"] > 10
    assert max(step["solves"] for step in result.steps) <= 5
    assert max(row["penetration"] for row in contact) < 0.1 * 1.51 / 36
    check_bones(result)
