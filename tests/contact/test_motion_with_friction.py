"""Newmark's method with friction: contact by its mean over a step, which gives no energy."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import create_problem, cube
from contact_problems import constant, march, nodes_mean, plane
from scipy.integrate import quad

from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Filling
from fem_snh.contact.facet_loops import response
from fem_snh.contact.obstacle_contact import ObstacleContact, RigidContact
from fem_snh.kernels.material import material
from fem_snh.steps.dynamics.dynamics import Dynamics
from fem_snh.terms.loads import Gravity, Spring

pytestmark = pytest.mark.one_debian

G, SIZE, E, DENSITY = 9.81, 0.1, 1e7, 1000.0


def sliding(comm, friction, duration, steps, stiffness=0.0):
    """Let a stiff cube with a velocity of 1 m/s slide; return positions and energies lost [J].

    It begins at rest on the ground, compressed by its weight, with springs under it.
    """
    made = []

    def contact(mesh, u, regions, dirichlet):
        made.append(
            ObstacleContact(u.function_space, regions, [RigidContact("ground", plane(), friction)])
        )
        return made

    spring = Spring(group="bottom", stiffness=(stiffness, 0.0, 0.0))
    p = create_problem(
        cube(comm, "hexahedron", 1, size=SIZE),
        ELEMENTS["Q1"],
        [Filling(material("stable_neo_hookean", E=E, nu=0.0), None, DENSITY)],
        loads=contact,
        features=[Gravity((0, 0, -G), constant), *([spring] if stiffness else [])],
        motion=lambda *body: Dynamics(*body, "newmark", duration=duration),
    )
    weight = DENSITY * G * SIZE
    down = -weight * (SIZE / (10 * E) + p.coordinates[:, 2] / (2 * E))
    p.x.array[: p.coordinates.size].reshape(-1, 3)[:, 2] = down
    x, lost = [0.0], [0.0]
    for _ in march(p, p.motion, steps, lambda X: np.tile([1.0, 0, 0], (len(X), 1)), 1e-9):
        x.append(nodes_mean(p)[0])
        lost.append(p.motion.energies(p)["numerical_dissipation"])
    return np.array(x), np.array(lost)


@pytest.mark.mpi
def test_a_block_slides_to_rest(comm):
    """After v^2 / (2 mu g), on steps that resolve no vibration; it was 15 % farther with 10 steps.

    The corners lift off and meet the ground again as friction begins and ends.
    """
    for steps, tolerance in ((10, 5e-3), (40, 5e-4)):
        x, lost = sliding(comm, 0.3, 1.5 / (0.3 * G), steps)
        assert x[-1] == pytest.approx(1 / (2 * 0.3 * G), rel=tolerance)
        assert np.diff(lost).min() > -1e-6


def test_a_block_on_a_spring_slides_back_and_forth():
    """Each half period takes 2 mu g / w^2 from the amplitude, until friction holds the spring.

    Contact gained 31 J, of the 0.5 J that the block has, in 40 steps.
    """
    w, friction, duration, steps = 2 * np.pi, 0.1, 2.0, 40
    x, lost = sliding(MPI.COMM_SELF, friction, duration, steps, DENSITY * SIZE * w**2)
    shift = friction * G / w**2  # of the spring's rest
    radius, phase = np.hypot(1 / w, shift), np.arctan2(1 / w, shift)

    def exact(t):
        if w * t < phase:
            return radius * np.cos(w * t - phase) - shift
        end, angle = radius - shift, w * t - phase
        while abs(end) > shift:
            rest = np.copysign(shift, end)
            if angle < np.pi:
                return rest + (end - rest) * np.cos(angle)
            end, angle = 2 * rest - end, angle - np.pi
        return end

    expected = [exact(t) for t in np.linspace(0, duration, steps + 1)]
    assert np.abs(x - expected).max() < 5e-3  # m, of an amplitude of 0.136
    assert np.diff(lost).min() > -5e-4


def test_mean_pressure():
    """It is minus the derivative of its energy, and takes what the energy of contact loses."""
    k, start = 2.0, np.array([-0.3, -0.3, -0.3, 0.2, 0.2, 0.0, 1e-3, 0.4])
    end = np.array([-0.1, 0.1, 30.0, -0.4, -1e-3, -0.2, -0.2, 0.1])
    energy, pressure, stiffness = response(None, *2 * [np.full(8, k)], end, start)
    p0, p1 = (np.maximum(-k * gap, 0) for gap in (start, end))
    np.testing.assert_allclose(pressure * (start - end), (p1**2 - p0**2) / (2 * k), rtol=1e-11)
    for i in range(len(start)):

        def at(gap, i=i):
            found = response(None, *2 * [np.array([k])], np.array([gap]), start[[i]])
            return [value[0] for value in found]

        kink = [0.0] if min(start[i], end[i]) < 0 < max(start[i], end[i]) else None
        work = quad(lambda g, at=at: float(at(g)[1]), end[i], start[i], points=kink)[0]
        assert energy[i] - at(start[i])[0] == pytest.approx(work, rel=1e-6, abs=1e-12)
        h = 1e-6
        slope = (at(end[i] - h)[1] - at(end[i] + h)[1]) / (2 * h)
        assert stiffness[i] == pytest.approx(slope, rel=1e-5, abs=1e-9)
