"""Steps along which stiff parts of a body turn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import stiff_parts
from benchmarks.contrast import SHAPES, inclusion
from fem_snh.problem.regime import StiffParts

mpi = pytest.mark.mpi
pytestmark = pytest.mark.filterwarnings("ignore::fem_snh.errors.ResultNote")


def two_spheres(c):
    """Two parts that do not touch, of 8 cells each in a mesh of 8^3 cells."""
    return (
        np.minimum(*(np.linalg.norm(c - side, axis=1) for side in ([0.25] * 3, [-0.25] * 3))) < 0.2
    )


@mpi
def test_each_connected_part_turns_by_itself_and_the_rest_moves_straight(comm):
    """Two parts with opposite rotation vectors, and a deformation that is kept."""
    problem = inclusion(comm, two_spheres, 1e4, 8, {})._problem
    X, retraction = problem.coordinates, problem.retraction
    omega, centre = np.array([0.3, -1.1, 0.7]), 0.25 * np.ones(3)
    sides = np.where(X.sum(axis=1, keepdims=True) > 1.5, 1.0, -1.0)
    r = X - 0.5 - sides * centre
    x, d, end = problem.x.duplicate(), problem.x.duplicate(), problem.x.duplicate()
    x.set(0.0)
    d.array = (sides * np.cross(omega, r) + [0.1, 0.2, 0.3]).ravel()
    retraction(x, d, 0.5, end)
    inside = np.abs(r).max(axis=1) < 0.125 + 1e-9
    assert comm.allreduce(int(inside.sum())) == 2 * 27
    turned = [Rotation.from_rotvec(0.5 * s * omega).as_matrix() for s in (1.0, -1.0)]
    exact = (
        np.where(sides > 0, r @ turned[0].T, r @ turned[1].T) - r + 0.5 * np.array([0.1, 0.2, 0.3])
    )
    found, straight = end.array_r.reshape(-1, 3), 0.5 * d.array_r.reshape(-1, 3)
    assert np.abs(found - exact)[inside].max(initial=0) < 1e-13
    assert np.array_equal(found[~inside], straight[~inside])


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize(("shape", "contrast"), [("bar", 1e4), ("bar", 1e8), ("sphere", 1e8)])
def test_a_stiff_inclusion_takes_no_more_iterations_than_none(comm, shape, contrast):
    """It turns by a finite angle in one step; the oracle is the same with two load steps."""
    one = inclusion(comm, SHAPES[shape], contrast, 8, {})
    one.solve()
    assert one.solver.getConvergedReason() > 0 and one.newton <= 12
    steps = inclusion(comm, SHAPES[shape], contrast, 8, {})
    rows = list(steps.steps(2))
    assert rows[-1]["converged"]
    energies = [p.solver.computeObjective(p.x) for p in (one, steps)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-6)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize(("body", "contrast"), [("bushing", 2e5), ("elbow", 1e5)])
def test_a_stiff_part_that_conditions_turn(comm, body, contrast):
    """Steel in rubber by 40 degrees, bones in flesh by 30, in a step; the oracle makes several."""
    cells = {"bushing": 4, "elbow": 12}[body]
    newton = []
    for ratio in (1.0, contrast):
        one = stiff_parts.BODIES[body](comm, ratio, cells)
        one.solve()
        assert one.solver.getConvergedReason() > 0
        newton.append(one.newton)
    assert newton[1] <= 1.5 * newton[0]
    steps = stiff_parts.BODIES[body](comm, contrast, cells)
    assert list(steps.steps(3))[-1]["converged"]
    energies = [p.solver.computeObjective(p.x) for p in (one, steps)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-5)


@pytest.mark.one_debian("ranks")
@mpi
def test_a_stiff_part_turns_about_what_is_constrained(comm):
    """A part on a hinge: nodes on a line stay, the others turn about it."""
    problem = inclusion(comm, lambda c: np.abs(c).max(axis=1) < 0.3, 1e4, 6, {})._problem
    X = problem.coordinates
    hinge = np.isclose(X[:, 0], 1 / 3) & np.isclose(X[:, 1], 1 / 3)
    hinge &= np.abs(X[:, 2] - 0.5) < 0.2
    assert comm.allreduce(int(hinge.sum())) == 3
    fixed, regions = np.tile(hinge[:, None], 3), [part.region for part in problem.elastic.parts]
    retraction = StiffParts.of(problem.V, regions, fixed, np.zeros(len(X), bool))
    omega, r = np.array([0.0, 0.0, 0.8]), X - [1 / 3, 1 / 3, 0.5]
    x, d, end = problem.x.duplicate(), problem.x.duplicate(), problem.x.duplicate()
    x.set(0.0)
    d.array = np.cross(omega, r).ravel()
    retraction(x, d, 1.0, end)
    inside = np.abs(X - 0.5).max(axis=1) < 1 / 6 + 1e-9
    exact = r @ Rotation.from_rotvec(omega).as_matrix().T - r
    found = end.array_r.reshape(-1, 3)
    assert np.abs(found - exact)[inside].max(initial=0) < 1e-5
    assert np.abs(found[hinge]).max(initial=0) < 1e-15
