"""Self-contact by a barrier in time: momentum."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from barrier_problems import GAP, intersects, needs_ipctk, pressed

from fem_snh import _dolfinx, solver
from fem_snh.assembly.kinematics import SOLID
from fem_snh.assembly.unknowns import add_ghosts, writable_values
from fem_snh.steps.dynamics.dynamics import Dynamics

pytestmark = needs_ipctk
COMM = MPI.COMM_WORLD


@pytest.mark.one_debian
@pytest.mark.parametrize("integrator", ["newmark", "backward_euler"])
def test_collision_in_time(integrator):
    """The upper block falls on the lower one, both free: momentum is exchanged, never lost."""
    made = []

    def inertia(u, regions, dirichlet):
        made.append(Dynamics(u, regions, dirichlet, SOLID, integrator, duration=0.25))
        return made[0].terms

    problem, term = pressed(COMM, "Q1", hold=(), move=(), terms=inertia, E=100.0, nu=0.0)
    (dynamics,) = made
    dynamics.start(problem, lambda X: -np.outer(X[:, 2] > 1 + GAP / 2, [0, 0, 1.0]))
    touched = False
    for row in move_in_time(problem, dynamics, 25):
        assert not intersects(problem, term)
        touched |= row["pairs"] > 0
        momentum = dynamics.energies(problem)["momentum"]
        np.testing.assert_allclose(momentum, [0, 0, -1], atol=1e-5)
    assert touched and row["pairs"] == 0
    assert momentum_above(problem, dynamics)[2] > -0.2  # exactly 0 for thin bars


def move_in_time(problem, dynamics, number):
    """Take equal steps in time; yield the rows of self-contact."""
    snes = solver.create(problem)
    snes.getPythonContext().options["snes_scaled_tol"] = 1e-10
    for load in np.arange(1, number + 1) / number:
        problem.history.begin_step(problem.split(problem.x)[0])
        dynamics.begin_step(problem, load)
        problem.set_load(load)
        problem.prescribe(problem.x)
        again = True
        while again:
            snes.solve(None, problem.x)
            assert snes.getConvergedReason() > 0
            again = problem.history.update_lagged(problem.split(problem.x)[0])
        u = problem.split(problem.x)[0]
        row = problem.history.record(u)["self_contact"]
        dynamics.end_step(problem)
        problem.history.end_step(u)
        yield row


def momentum_above(problem, dynamics):
    """Return the momentum of the upper block (3,). Collective."""
    vector = _dolfinx.create_vector(problem.V)
    writable_values(vector)[:] = dynamics.mass.apply(dynamics.v.x.array)
    add_ghosts(vector)
    upper = problem.coordinates[:, 2] > 1 + GAP / 2
    return COMM.allreduce(vector.array_r.reshape(-1, 3)[upper].sum(axis=0))
