"""Self-contact by a barrier: two blocks pressed together or in motion, never an intersection."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from barrier_problems import GAP, intersects, needs_ipctk, pressed, steps
from bodies import Hold
from contact_problems import march

from fem_snh import _dolfinx
from fem_snh.assembly.kinematics import SOLID
from fem_snh.assembly.unknowns import add_ghosts, writable_values
from fem_snh.steps.dynamics.dynamics import Dynamics

pytestmark = needs_ipctk
mpi = pytest.mark.mpi
COMM = MPI.COMM_WORLD


@pytest.mark.one_debian
@mpi
def test_two_blocks_pressed_together():
    """Ten steps: no intersection, action is reaction, the same forces as on one rank alone."""
    problem, term = pressed(COMM)
    alone, _ = pressed(MPI.COMM_SELF)
    newton = 0
    for row, reference in zip(steps(problem, 10), steps(alone, 10), strict=True):
        assert row["converged"], row["reason"]
        assert not intersects(problem, term)
        newton += row["newton"]
        found, expected = row["self_contact"], reference["self_contact"]
        lower, upper = np.array(found["bodies"])
        size = np.linalg.norm(lower)
        np.testing.assert_allclose(lower + upper, 0, atol=1e-6 * size)
        np.testing.assert_allclose(found["bodies"], expected["bodies"], atol=1e-5 * size)
        assert 0 < found["distance"] < found["activation"] == term.distance
    assert newton <= 70  # 100 in a trial that predicted nothing
    assert size > 0.1 and row["solves"] == 1


@pytest.mark.one_debian("serial")
def test_one_function_along_a_line():
    """Energy, forces and Hessian of a step, where pairs end and begin, against differences.

    The upper block lifts off and slides: all pairs end on the way.
    """
    problem, term = pressed(MPI.COMM_SELF, shear=0.1)
    *_, last = steps(problem, 4)
    assert last["converged"]
    start, d, X, h = problem.x.copy(), problem.x.duplicate(), problem.coordinates, 1e-6
    motion = np.zeros(X.shape)
    motion[X[:, 2] > 1 + GAP / 2] = [-0.3, 0.1, 1.0]
    d.array[:] = motion.ravel()
    problem.history.begin_step(problem.split(start)[0])
    problem.set_load(problem.load)

    def at(t):
        x = start.copy()
        x.axpy(t, d)
        return x

    def energy(t):
        return term.energy(problem.split(at(t))[0])

    def forces(t):
        x = at(t)
        problem.gradient(x, r := x.duplicate(), [term])
        return r

    def product(t):
        u, found = problem.split(at(t))[0], d.duplicate()
        problem.matrix.couple([term.couplings(u)])
        with problem.matrix.adding():
            term.add_hessian(u, None, "exact", problem.matrix)
        problem.matrix.mat.mult(d, found)
        found.array[problem.constrained_dofs] = 0.0
        return found

    free, counts = np.ones(len(d.array)), []
    free[problem.constrained_dofs] = 0.0
    slopes = [forces(t).dot(d) for t in (-0.002, 0.003, 0.009, 0.02)]
    scale = max(map(abs, slopes))
    for t, slope in zip((-0.002, 0.003, 0.009, 0.02), slopes, strict=True):
        assert (energy(t + h) - energy(t - h)) / (2 * h) == pytest.approx(slope, abs=1e-6 * scale)
        counts.append(term.record(problem.split(at(t))[0])["self_contact"]["pairs"])
    assert counts[0] > counts[2] > counts[3] == 0
    d.array[:] *= free
    for t in (-0.002, 0.003, 0.009):
        difference, expected = forces(t + h) - forces(t - h), product(t)
        difference.array[:] *= free / (2 * h)
        assert (difference - expected).norm() < 1e-6 * product(-0.002).norm()


@pytest.mark.one_debian("serial")
def test_force_is_that_of_the_strain():
    """With nu = 0 both blocks are springs in series, and the barrier takes a part of the gap."""
    rollers = [Hold("bottom", ("z",)), Hold("left", ("x",)), Hold("front", ("y",))]
    problem, _ = pressed(COMM, "Q1", (2, 2), 0.06, nu=0.0, hold=rollers, components=("z",))
    (row,) = steps(problem, 1, tolerance=1e-10)
    found = row["self_contact"]
    strain = (0.06 - (GAP - found["distance"])) / 2
    assert found["bodies"][1][2] == pytest.approx(strain, rel=0.02)
    assert found["force"] == pytest.approx(strain, rel=0.02)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("globalization", ["linesearch", "trust_region"])
def test_no_iterate_intersects(globalization):
    """One long step: neither the prediction nor any iteration passes through a surface."""
    problem, term = pressed(COMM, press=0.35, nu=0.45)
    seen = []

    def check(snes, iteration):
        seen.append(intersects(problem, term))

    rows = list(steps(problem, 2, tolerance=1e-7, globalization=globalization, update=check))
    assert rows[-1]["converged"] and problem.load == 1
    assert len(seen) > 5 and not any(seen)


@pytest.mark.one_debian("ranks")
@mpi
def test_largest_step():
    """The upper block falls by twice the gap: half of the step, and a tenth before it."""
    problem, term = pressed(COMM)
    d = np.zeros(problem.coordinates.shape)
    d[problem.coordinates[:, 2] > 1 + GAP / 2, 2] = -2 * GAP
    admitted = term.largest_step(np.zeros_like(d), d)
    assert 0.4 < admitted < 0.5
    assert COMM.allgather(admitted) == [admitted] * COMM.size
    assert term.largest_step(np.zeros_like(d), -d) == 1
    assert term.largest_step(np.zeros_like(d), 0 * d) == 1


@mpi
def test_prescribed_motion_through_the_body():
    """A motion that would pass through a surface fails with the reason, and is halved."""
    problem, term = pressed(COMM, press=1.2, hold=[Hold("bottom"), Hold("lower_top")])
    found = steps(problem, 1, tolerance=1e-7)
    reason = next(found)["reason"]
    assert "the prescribed motion of the step is too large: it takes a surface" in reason
    assert any(row["converged"] for row in found) and 0 < problem.load < 1
    assert not intersects(problem, term)


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
    pairs, upper = [], problem.coordinates[:, 2] > 1 + GAP / 2
    for _ in march(problem, dynamics, 25, lambda X: -np.outer(X[:, 2] > 1 + GAP / 2, [0, 0, 1.0])):
        assert not intersects(problem, term)
        pairs.append(term.record(problem.split(problem.x)[0])["self_contact"]["pairs"])
        momentum = dynamics.energies(problem)["momentum"]
        np.testing.assert_allclose(momentum, [0, 0, -1], atol=1e-5)
    assert max(pairs) > 0 and pairs[-1] == 0
    vector = _dolfinx.create_vector(problem.V)
    writable_values(vector)[:] = dynamics.mass.apply(dynamics.v.x.array)
    add_ghosts(vector)
    # The momentum of the upper block, exactly 0 for thin bars.
    assert COMM.allreduce(vector.array_r.reshape(-1, 3)[upper, 2].sum()) > -0.2
