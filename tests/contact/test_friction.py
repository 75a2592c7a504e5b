"""Friction on obstacles: slopes, sticking without creep, and moving ground."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import cube
from contact_problems import accurate_snes, constant, contact_problem, march, nodes_mean, plane

from fem_snh.contact.obstacle_contact import RigidContact
from fem_snh.runs import run
from fem_snh.scenes import Scene
from fem_snh.steps.stepping import Stepper, StepSolver
from fem_snh.terms import history

pytestmark = pytest.mark.one_debian

mpi = pytest.mark.mpi

G = 9.81


def slope(comm, friction, angle, duration, steps, integrator="backward_euler"):
    """Let a cube of mass 1 go on a slope; yield time, velocity along it, and its row."""
    body = cube(comm, "hexahedron", 1, size=0.1)
    gravity = G * np.array([np.sin(angle), 0, -np.cos(angle)])
    time = {"integrator": integrator, "duration": duration}
    p, _, dynamics = contact_problem(
        body, "Q1", [RigidContact("slope", plane(), friction)],
        E=1e6, density=1000.0, gravity=gravity, amplitude=constant, time=time,
    )  # fmt: skip
    for step, row in enumerate(march(p, dynamics, steps), 1):
        momentum = dynamics.energies(p)["momentum"]
        yield duration * step / steps, momentum[0], row["slope"]


def test_a_block_slides_down_a_slope(comm):
    """Friction 0.3 at 30 degrees: g (sin - 0.3 cos) = 2.3563 m/s^2."""
    rows = list(slope(comm, 0.3, np.radians(30), 0.4, 20))
    (t, v, row), (t0, v0, _) = rows[-1], rows[4]
    assert (v - v0) / (t - t0) == pytest.approx(2.3563, rel=0.02)
    assert v / t == pytest.approx(2.3563, rel=0.02)
    normal = G * np.cos(np.radians(30))
    np.testing.assert_allclose(row["force"], [-0.3 * normal, 0, normal], rtol=0.02, atol=1e-3)
    assert 0 < row["sliding"] <= row["contacts"] and row["solves"] < 6


@pytest.mark.parametrize("friction, sticks", [(0.55, True), (0.45, False)])
def test_sticks_and_slips(comm, friction, sticks):
    """On a slope of tangent 0.5."""
    angle = np.arctan(0.5)
    rows = list(slope(comm, friction, angle, 0.4, 20))
    speeds = np.array([v for _, v, _ in rows])
    if sticks:
        assert np.abs(speeds[10:]).max() < 1e-4 * G * 0.4
        assert rows[-1][2]["sliding"] == 0
    else:
        a = G * (np.sin(angle) - friction * np.cos(angle))
        assert speeds[-1] / 0.4 == pytest.approx(a, rel=0.02)


def settled(comm, friction, steps):
    """A cube that is first heavy and then pulled sideways; mean displacements and the last row."""
    sideways = np.array([0.3 * G, 0, 0]), lambda load: np.clip(4 * load - 1, 0, 1)
    p, _, _ = contact_problem(
        cube(comm, "tetrahedron", 2), "P1", [RigidContact("ground", plane(), friction)],
        E=1e4, density=1.0, gravity=(0, 0, -G), amplitude=lambda load: min(4 * load, 1.0),
        sideways=sideways,
    )  # fmt: skip
    stepper = Stepper(StepSolver(p, accurate_snes(p), "none"), steps)
    found = [(row, nodes_mean(p)) for row in stepper]
    assert stepper.done
    return [mean for _, mean in found], found[-1][0]["obstacles"]["ground"]


@pytest.mark.mpi
def test_a_sticking_block_does_not_creep(comm):
    """Held by friction alone: it stays where it is, and more steps lead to the same state."""
    means, row = settled(comm, 0.5, 4)
    np.testing.assert_allclose(row["force"], [-0.3 * G, 0, G], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(means[2:], [means[1]] * 2, rtol=1e-4, atol=1e-9)
    assert row["sliding"] < row["contacts"] and 0 < means[-1][0] < 1e-3


def strut(coefficient):
    """A cube, held on the left; a plate at 60 degrees to its axis presses and slides on its edge.

    Friction presses the edge on the plate: with the coefficient 2 the normal force of a solve
    decreases by more than friction's lagged normal force increases.
    """
    normal, along = np.array([-0.5, 0, np.sqrt(0.75)]), np.array([np.sqrt(0.75), 0, 0.5])
    plate = {
        "name": "plate",
        "shape": {"plane": {"point": [1, 0, 0], "normal": normal.tolist()}},
        "translate": (0.05 * normal + 0.1 * along).tolist(),
        "friction": coefficient,
    }
    material = {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3}
    scene = {
        "name": "strut", "mesh": {"source": "cube"}, "cells": 3, "element": "Q1", "steps": 4,
        "predictor": "none", "material": material, "hold": [{"group": "left"}],
        "obstacle": [plate],
    }  # fmt: skip
    return Scene.model_validate(scene), normal, along


@mpi
@pytest.mark.parametrize("coefficient", [1.0, 2.0])
def test_friction_that_presses_its_surface_settles(coefficient):
    """The sliding edge has Coulomb's ratio of tangential and normal force, in each step."""
    scene, normal, along = strut(coefficient)
    result = run(scene, progress=False)
    assert result.converged and len(result.steps) == 4
    for step in result.steps[2:]:
        row = step["obstacles"]["plate"]
        force = np.array(row["force"])
        assert row["sliding"] == row["contacts"] > 0
        assert force @ along == pytest.approx(coefficient * (force @ normal), rel=2e-3)
        assert step["lagged_change"] <= 1 and step["solves"] <= 12


@mpi
def test_friction_that_has_not_settled_fails_the_step(monkeypatch):
    """Such a step is halved as any other; the run ends without convergence, and says why."""
    monkeypatch.setattr(history, "MAX_SOLVES", 3)
    result = run(strut(2.0)[0], progress=False)
    assert not result.converged
    reason = "obstacle 'plate': the change of friction's normal forces is"
    assert f"1/64 of the nominal one still fails (DIVERGED_INNER: {reason}" in result.status
    failed = [step for step in result.steps if not step["converged"]]
    assert len(failed) >= 7  # 1, 1/2, ... 1/64 of a step
    for step in failed:
        assert step["reason"].startswith(f"DIVERGED_INNER: {reason}")
        assert step["reason"].endswith("times the tolerance after 3 solves")
        assert step["solves"] == 3 and step["lagged_change"] > 1
