"""Runs of scenes with obstacles and with contact of bodies: rows and fields."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import slide
from running import record, solve

from benchmarks import plates
from fem_snh import scenes
from fem_snh.viewing.stored_run import written_fields


@pytest.mark.one_debian
@pytest.mark.mpi
def test_a_plate_presses_and_rubs(comm, folder):
    """The force on the block is that on its fixed side; friction is at most 0.3 of the pressure."""
    scene = slide().model_copy(update={"reactions": [scenes.Reaction("bottom")]})
    result = solve(scene, comm=comm, out=folder)
    assert result.converged and result.record["terms"] == ["elastic", "obstacle"]
    forces = []
    for step in record(folder)["steps"]:
        plate = step["obstacles"]["plate"]
        reaction = np.array(step["reactions"]["bottom"])
        np.testing.assert_allclose(plate["force"], -reaction, atol=1e-9)
        x, y, z = plate["force"]
        assert z < 0 and 0 < np.hypot(x, y) <= 0.3 * abs(z) * (1 + 1e-3)
        assert 0 < plate["penetration"] < 0.01 and plate["contacts"] == 16
        forces.append(-z)
    assert forces[-1] > forces[0]
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


@pytest.mark.one_debian("ranks")
@pytest.mark.mpi
def test_the_force_between_two_blocks_is_that_on_their_supports(comm, folder):
    """The upper one is wider: it bulges over the lower one."""
    parameters = {"upper_width": 1.4, "shift": -0.2}
    scene = scenes.Scene(
        name="blocks", mesh={"source": "two_blocks", "parameters": parameters}, cells=2,
        element="Q1", steps=2, material={"name": "stable_neo_hookean", "E": 1.0, "nu": 0.49},
        hold=[{"group": "bottom"}], move=[{"group": "top", "translate": [0.0, 0.0, -0.2]}],
        contact=[{"groups": ["upper_bottom", "lower_top"], "method": "augmented_lagrangian"}],
        reactions=["bottom", "top"],
    )  # fmt: skip
    solve(scene, comm, out=folder)
    comm.barrier()
    whole = record(folder)
    assert whole["converged"] and whole["terms"] == ["elastic", "contact"]
    for row in whole["steps"]:
        contact = row["contacts"]["upper_bottom/lower_top"]
        assert contact["force"][2] == pytest.approx(row["reactions"]["bottom"][2], rel=1e-5)
        assert contact["force"][2] == pytest.approx(-row["reactions"]["top"][2], rel=1e-5)
        assert contact["force"][2] > 0 and contact["contacts"] > 0 and row["solves"] > 1
        # A thousandth of a cell's height.
        assert contact["penetration"] <= 0.5e-3 and contact["stiffness"] == pytest.approx(20.0)
    header = (folder / "steps.csv").read_text().splitlines()[0].split(",")
    assert {"upper_bottom/lower_top.force.z", "solves"} <= {*header}


@pytest.mark.one_debian
def test_thin_plates_collide():
    """A plate falls on another one, eight times as wide as thick; whole surfaces may touch."""
    scene = plates.plates("Q1", "bdf2", "penalty", cells=3, steps=16)
    row = plates.measure(scene)
    assert row["ok"] and row["steps_in_contact"] >= 8
