"""The work of moving obstacles, and the energy that friction dissipates."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import cube
from contact_problems import constant, contact_problem, march, nodes_mean, plane, translation
from scipy.optimize import brentq
from two_bodies import ROLLERS

import fem_snh
from fem_snh.contact.obstacle_contact import RigidContact
from fem_snh.geometry.motions import DisplacementMotion

pytestmark = [pytest.mark.mpi, pytest.mark.one_debian]
G = 9.81


def accelerated(vector):
    """A motion from rest with a constant acceleration, by ``vector`` at load 1."""
    return DisplacementMotion(
        lambda X, load: np.tile(load**2 * np.asarray(vector, float), (len(X), 1))
    )


@pytest.mark.parametrize("integrator, lost", [
    ("newmark", 0.01), ("backward_euler", 0.02), ("semi_implicit", 0.02),
])  # fmt: skip
def test_a_press(comm, integrator, lost):
    """A slow press: its work is the energy of uniaxial compression, and that of the penalty."""
    E, nu, size, depth = 1e5, 0.3, 0.1, 0.02
    press = plane((0, 0, size), (0, 0, -1), translation((0, 0, -depth)))
    p, contact, dynamics = contact_problem(
        cube(comm, "tetrahedron", 2, size=size), "P1", [RigidContact("press", press)],
        E=E, nu=nu, density=1000.0, hold=ROLLERS,
        time={"integrator": integrator, "duration": 0.2, "damping": (0.0, 1e-3)},
    )  # fmt: skip
    contact.pairs[0].linearised = integrator == "semi_implicit"
    *_, row = march(p, dynamics, 80)
    found, force = dynamics.energies(p), row["press"]["force"][2]
    stored = found["elastic"] + found["potential"] + found["kinetic"]
    assert found["kinetic"] < 1e-3 * stored
    m, k = fem_snh.material("stable_neo_hookean", E=E, nu=nu), contact.pairs[0].law.stiffness.max()
    k = comm.allreduce(float(k), op=MPI.MAX)

    def deformation(s):
        """Return the deformation gradient with free sides and the stretch s in z."""
        sides = brentq(lambda t: m.pk1(np.diag([t, t, s]))[0, 0], 0.9, 1.5, xtol=1e-15)
        return np.diag([sides, sides, s])

    def gap(s):
        return -m.pk1(deformation(s))[2, 2] / k + (1 - s) * size - depth

    F = deformation(brentq(gap, 0.5, 1.0, xtol=1e-15))
    pressure = -m.pk1(F)[2, 2]
    energy = m.energy(F) - m.energy(np.eye(3)) + pressure**2 / (2 * k * size)
    # Damping adds beta E' times the rate of 1/s of the strain: 100 Pa of 21 kPa.
    assert -force == pytest.approx(pressure * size**2, rel=0.01)
    assert stored == pytest.approx(energy * size**3, rel=2e-3)
    assert found["work"] - found["dissipated"] == pytest.approx(stored, rel=lost)


def test_a_belt_drags_a_block(comm):
    """It slides backwards on the belt: work m g mu s, of which the relative path is dissipated."""
    belt = plane(motion=accelerated((0.1, 0, 0)))  # 20 m/s^2
    p, _, dynamics = contact_problem(
        cube(comm, "hexahedron", 1, size=0.1), "Q1", [RigidContact("belt", belt, 0.5)],
        E=1e6, density=1000.0, gravity=(0, 0, -G), amplitude=constant,
        time={"integrator": "backward_euler", "duration": 0.1},
    )  # fmt: skip
    list(march(p, dynamics, 100))
    found, distance = dynamics.energies(p), nodes_mean(p)[0]
    assert distance == pytest.approx(0.5 * 0.5 * G * 0.1**2, rel=0.02)
    assert found["work"] == pytest.approx(0.5 * G * 0.1, rel=0.02)
    assert found["dissipated"] == pytest.approx(0.5 * G * (0.1 - distance), rel=0.02)
