"""Impacts: a bar on a wall against the exact solution, and the energy of a bouncing ball."""

from __future__ import annotations

import numpy as np
import pytest
from contact_problems import contact_problem, march, plane
from running import solve

from benchmarks import plates
from fem_snh import _dolfinx
from fem_snh.contact.obstacle_contact import RigidContact
from fem_snh.mesh import mesh
from fem_snh.scenes import Traction

pytestmark = pytest.mark.one_debian

AUGMENTED = "augmented_lagrangian"


def strip(comm, length, cells):
    """A bar along x of one hexahedron after the other."""
    x = length / cells * np.stack(np.meshgrid(range(cells + 1), (0, 1), (0, 1), indexing="ij"), -1)
    corners = 4 * np.arange(cells)[:, None] + np.array([0, 4, 2, 6, 1, 5, 3, 7])
    mine = slice(None) if comm.rank == 0 else slice(0)
    points = x.reshape(-1, 3).astype(float)
    domain = _dolfinx.create_mesh(comm, corners[mine], points[mine], "hexahedron", 1)
    return mesh.Mesh(domain, "hexahedron", (), cells)


@pytest.mark.parametrize(
    ("integrator", "cells", "rebound", "force"),
    [("newmark", 40, 0.99, 0.005), ("backward_euler", 20, 0.7, 0.1)],
)
def test_a_bar_against_a_wall(comm, integrator, cells, rebound, force):
    """It stays for 2 L/c = 8.0e-5 s with the force rho c v A, and leaves with its own speed."""
    E, rho, length = 2e11, 8000.0, 0.2
    c, h = np.sqrt(E / rho), length / cells
    # A contact as stiff as the cells, which half a cell's travel time resolves.
    wall = RigidContact("wall", plane((0, 0, 0), (1, 0, 0)), stiffness=E / h)
    steps = int(2.6 * cells / 0.5)
    duration = steps * 0.5 * h / c
    p, _, dynamics = contact_problem(
        strip(comm, length, cells), "Q1", [wall], E=E, nu=0.0, density=rho,
        time={"integrator": integrator, "duration": duration},
    )  # fmt: skip
    rows = march(p, dynamics, steps, lambda X: np.tile([-1.0, 0, 0], (len(X), 1)))
    forces = np.array([row["wall"]["force"][0] for row in rows]) / (rho * c * h**2)
    times = duration * np.arange(1, steps + 1) / steps
    touching = times[forces > 1e-6]
    assert touching[0] == times[0]
    momentum = dynamics.energies(p)["momentum"][0] / (rho * length * h**2)
    assert rebound <= momentum <= 1.005
    inside = (times > 0.1 * 8e-5) & (times < 0.9 * 8e-5)
    assert forces[inside].mean() == pytest.approx(1.0, abs=force)
    if integrator == "newmark":
        assert touching[-1] == pytest.approx(8.0e-5, rel=0.015)
        energies = dynamics.energies(p)
        total = energies["kinetic"] + energies["elastic"]
        assert total == pytest.approx(0.5 * rho * length * h**2, rel=0.005)


@pytest.mark.parametrize(("method", "steps"), [("penalty", 12), ("penalty", 25), (AUGMENTED, 12)])
def test_newmark_keeps_energy_and_momentum_of_bodies_that_collide(comm, method, steps):
    """A plate is pushed onto another one, both free.

    By the trapezoidal rule the energy grew by 25 % of the largest kinetic one in 12 steps on the
    fixed plate. The mean forces have no sum, and do the work that the energy of contact loses.
    """
    pressure = 100.0
    load = Traction(group="top", vector=(0, 0, -pressure))
    given = {"hold": [], "gravity": None, "traction": [load]}
    scene = plates.plates("Q1", "newmark", method, cells=3, steps=steps)
    result = solve(scene.model_copy(update=given), comm)
    rows = result.steps
    assert all(row["converged"] for row in rows)  # no step was halved
    assert max(row["contacts"]["lower_surface/upper_surface"]["contacts"] for row in rows) > 0
    impulse = -pressure * plates.WIDTH**2 * rows[-1]["time"]
    np.testing.assert_allclose(rows[-1]["momentum"], [0, 0, impulse], atol=2e-5 * abs(impulse))
    lost = [row["numerical_dissipation"] for row in rows]
    largest = max(row["kinetic"] for row in rows)
    assert min(lost) > -2e-3 * largest
    assert method == AUGMENTED or max(lost) < 5e-3 * largest
