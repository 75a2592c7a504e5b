"""Newmark's method with obstacles: contact by its mean over a step gives no energy."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import cube
from contact_problems import constant, contact_problem, march, nodes_mean, plane
from running import solve
from time_scenes import DOWN, in_time

from fem_snh.contact.obstacle import Obstacle
from fem_snh.contact.obstacle_contact import RigidContact
from fem_snh.geometry.motions import DisplacementMotion
from fem_snh.scenes import Hold, MaterialChoice, Start

G, SIZE, DENSITY = 9.81, 0.1, 1000.0
#: Sides that move up and down: a cube that bounces does not begin to turn.
UPRIGHT = [Hold(group=group, components=["x"]) for group in ("left", "right")]
UPRIGHT += [Hold(group=group, components=["y"]) for group in ("front", "back")]


def bounce(comm, steps, duration, stiffness=1e6, drop=0.02):
    """Drop a nearly rigid cube on springs; return heights, forces, m a and energies lost."""
    ground = RigidContact("ground", plane((0, 0, -drop)), stiffness=stiffness)
    p, _, dynamics = contact_problem(
        cube(comm, "hexahedron", 1, size=SIZE), "Q1", [ground], E=1e8, nu=0.0, density=DENSITY,
        hold=UPRIGHT,
        gravity=(0, 0, -G), amplitude=constant,
        time={"integrator": "newmark", "duration": duration},
    )  # fmt: skip
    rows = []
    for row in march(p, dynamics, steps, tolerance=1e-10):
        inertia = comm.allreduce(dynamics.mass.apply(dynamics.a.x.array)[2::3].sum())
        lost = dynamics.energies(p)["numerical_dissipation"]
        rows.append((nodes_mean(p)[2], row["ground"]["force"][2], inertia, lost))
    return np.array(rows).T


def height(t, stiffness=1e6, drop=0.02):
    """Return the exact height of a rigid cube: free flight, and half waves on the springs."""
    w, sink = np.sqrt(stiffness / (DENSITY * SIZE)), DENSITY * G * SIZE / stiffness
    speed, fall = np.sqrt(2 * G * drop), np.sqrt(2 * drop / G)
    phase, radius = np.arctan2(speed / w, sink), np.hypot(sink, speed / w)
    t = np.mod(t + fall, 2 * fall + 2 * (np.pi - phase) / w) - fall
    on_springs = -drop - sink + radius * np.cos(phase + w * (t - fall))
    return np.where(t < fall, -G * t**2 / 2, on_springs)


@pytest.mark.one_debian
def test_a_mass_on_springs(comm):
    """Second order through lift-off and impact; the force and the acceleration are the end's."""
    errors = []
    for steps in (100, 400):
        z, force, inertia, lost = bounce(comm, steps, 0.5)
        errors.append(np.abs(z - height(np.linspace(0, 0.5, steps + 1)[1:])).max())
        np.testing.assert_allclose(inertia, force - DENSITY * G * SIZE**3, atol=1e-3)
        assert np.abs(lost).max() < 1e-5  # of 0.196 J
        peak = DENSITY * G * SIZE**3 + 10 * np.hypot(9.81e-2, np.sqrt(2 * G * 0.02) * 10)
        assert force.max() == pytest.approx(peak, rel=0.02)
    assert errors[1] < 4e-4 and errors[0] / errors[1] > 8


@pytest.mark.mpi
def test_a_paddle(comm):
    """A plane that turns throws a cube: its work is the energy that the cube has."""

    def turn(X, load):
        angle = 1.5 * load**2
        c, s = np.cos(angle), np.sin(angle)
        change = np.array([[c - 1, 0, -s], [0, 0, 0], [s, 0, c - 1]])
        return (X + np.array([0.3, 0, 0])) @ change.T

    paddle = RigidContact("paddle", plane(motion=DisplacementMotion(turn)))
    for steps, tolerance in ((20, 1e-3), (80, 1e-4)):
        p, _, dynamics = contact_problem(
            cube(comm, "hexahedron", 1, size=SIZE), "Q1", [paddle], E=1e6, density=DENSITY,
            time={"integrator": "newmark", "duration": 0.4},
        )  # fmt: skip
        list(march(p, dynamics, steps))
        found = dynamics.energies(p)
        assert found["work"] == pytest.approx(24, rel=0.02) and found["momentum"][2] > 4
        assert abs(found["numerical_dissipation"]) < tolerance * found["work"]


@pytest.mark.one_debian("serial")
@pytest.mark.mpi
@pytest.mark.parametrize(("method", "lost"), [("penalty", 1.5), ("augmented_lagrangian", 90)])
def test_a_block_that_rocks(comm, method, lost):
    """It has 583 J. Contact gave it 379 J and 468 J in 12 steps; multipliers lose some."""
    floor = {"name": "floor", "shape": {"plane": {}}, "method": method}
    for steps in (12, 48):
        scene = in_time(
            {"duration": 1.2, "steps": steps, "integrator": "newmark"},
            cells=1,
            material=MaterialChoice(name="stable_neo_hookean", E=1e6, nu=0.3, density=DENSITY),
            gravity=DOWN,
            start=Start(velocity=(1, 0, 0), angular_velocity=(0, 1, 0)),
            obstacle=[Obstacle.model_validate(floor)],
        )
        rows = solve(scene, comm).steps
        changes = [row["numerical_dissipation"] for row in rows]
        assert min(changes) > -4 and max(changes) < (lost if steps == 48 else max(lost, 4))
