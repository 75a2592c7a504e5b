"""Runs of scenes with obstacles: rows, fields, groups and mistakes."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import slide
from running import record, solve

from fem_snh import scenes
from fem_snh.viewing.stored_run import written_fields


@pytest.mark.one_debian
@pytest.mark.mpi
def test_a_plate_presses_and_rubs(comm, tmp_path):
    """The force on the block is that on its fixed side; friction is at most 0.3 of the pressure."""
    folder = comm.bcast(tmp_path)
    scene = slide().model_copy(update={"reactions": [scenes.Reaction("bottom")]})
    result = solve(scene, comm=comm, out=folder)
    assert result.converged and result.record["terms"] == ["elastic", "obstacle"]
    steps = record(folder)["steps"]
    for step in steps:
        plate = step["obstacles"]["plate"]
        np.testing.assert_allclose(
            plate["force"], -np.array(step["reactions"]["bottom"]), atol=1e-9
        )
        x, y, z = plate["force"]
        assert z < 0 and 0 < np.hypot(x, y) <= 0.3 * abs(z) * (1 + 1e-3)
        assert 0 < plate["penetration"] < 0.01 and plate["contacts"] == 16
    assert (
        -steps[-1]["obstacles"]["plate"]["force"][2] > -steps[0]["obstacles"]["plate"]["force"][2]
    )
    assert {"contact_pressure", "gap"} <= set(written_fields(folder / "fields.pvd"))


@pytest.mark.mpi
def test_a_ball_bounces(comm):
    """Newton's second law: the momentum changes by gravity and the force of the ground.

    With bdf2 it holds at the end of each step, (3 p - 4 p_1 + p_2) / 2 h = F - m g.
    """
    options = {"time.duration": 0.4, "steps": 12, "integrator": "bdf2"}
    result = solve("bounce", comm=comm, cells=2, **options)
    rows = result.record["steps"]
    p = np.array([row["momentum"][2] for row in rows])
    force = np.array([row["obstacles"]["ground"]["force"][2] for row in rows])
    t, h = np.array([row["time"] for row in rows]), 0.4 / 12
    free = t < (2 * 0.5 / 9.81) ** 0.5  # it falls by 0.5 m
    mass = -p[0] / (9.81 * t[0])
    np.testing.assert_allclose(p[free], -mass * 9.81 * t[free], rtol=1e-6)
    assert not force[free].any() and (force[~free] > 0).all() and free.sum() == 9
    rate = (3 * p[2:] - 4 * p[1:-1] + p[:-2]) / (2 * h)
    np.testing.assert_allclose(rate, force[2:] - mass * 9.81, atol=1e-3 * force.max())
    # The mass is that of the mesh of the ball, inscribed in it: 90 % with 2 cells.
    assert 0.7 < mass / (1000 * 4 / 3 * np.pi * 0.5**3) < 1
