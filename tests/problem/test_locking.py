"""The note on an element that locks: the indicator, and silence."""

from __future__ import annotations

from math import sqrt

from mpi4py import MPI

import numpy as np
import pytest
from note_scenes import bushing, cube
from running import solve

from fem_snh.problem.state_notes import may_lock, pressure_oscillation

pytestmark = pytest.mark.one_debian

mpi = pytest.mark.mpi


def oscillation(problem):
    # The residual of a state that is no equilibrium is large: it is not asked.
    problem.residual = lambda x, r: r.set(0.0)
    return pressure_oscillation(problem, may_lock(problem))


@pytest.mark.parametrize("nu", [0.45, 0.4999])
def test_one_cell_in_bending(nu):
    """u_x = c x y in one cube: J - 1 = c y, its nodal means are a third of that."""

    def bend(X):
        x, y = (X[:, i] - 0.5 for i in (0, 1))
        return np.stack([1e-6 * x * y, 0 * x, 0 * x], axis=1)

    problem = cube(MPI.COMM_SELF, 1, "Q1", nu, bend)
    mu, lam = problem.regions[0].material.lame
    rough, shear = (2 / 3) / sqrt(3), sqrt(2 / 9 + 1 / 6)
    # The deviator is increased by a thousandth of the strain's norm, sqrt(1/3 + 1/6).
    expected = lam * rough / (2 * mu * (shear + 1e-3 * sqrt(0.5)))
    assert oscillation(problem) == pytest.approx(expected, rel=1e-5)


@mpi
@pytest.mark.parametrize("name", ["Q1", "P1", "P2"])
def test_homogeneous_states_do_not_oscillate(comm, name):
    """Confined compression, uniform compression, and shear: whatever the pressure is."""
    shear = np.array([[1, 0.3, 0], [0, 1, 0], [0, 0, 1]])
    for F in (np.diag([1, 1, 0.8]), np.diag([0.9] * 3), shear):
        problem = cube(comm, 3, name, 0.4999, lambda X, F=F: X @ (F - np.eye(3)).T)
        assert oscillation(problem) < 1e-7


def test_a_smooth_pressure_does_not_oscillate():
    """J - 1 linear in space, 100 times the shear strain: of the order of the cells, not of nu."""

    def squeeze(X):
        return np.stack([0 * X[:, 0], 0 * X[:, 0], 0.01 * X[:, 2] ** 2], axis=1)

    found = [oscillation(cube(MPI.COMM_SELF, n, "Q2", 0.45, squeeze)) for n in (4, 8)]
    assert found[1] < 0.75 * found[0] < 0.75


@mpi
def test_a_bushing_of_linear_tetrahedra_locks(comm, folder):
    """178 times too stiff on a finer mesh; the truth is Taylor-Hood's, on the same mesh."""
    found = {}
    for name in ("P1", "P2P0", "P2P1"):
        result = solve(bushing(comm, folder, name, 0.4999), comm=comm)
        assert result.converged
        force = abs(result.steps[-1]["reactions"]["inner"][0])
        found[name] = force, [note for note in result.notes if note["kind"] == "locking"]
    assert found["P2P0"][1] == found["P2P1"][1] == []
    note = found["P1"][1][0]
    assert found["P1"][0] / found["P2P1"][0] > 100
    assert note["oscillation"] > 100 and note["replacement"] == "P2P0" and note["step"] == 1
    text = "element = 'P1' locks at nu = 0.4999: "
    assert note["text"].startswith(text) and "take element = 'P2P0'" in note["text"]


@pytest.mark.parametrize(("name", "cells"), [("Q1", 4), ("Q1", 8), ("Q2", 2)])
def test_cooks_membrane_that_is_too_stiff_has_a_note(name, cells):
    found = {}
    for key in (name, {"Q1": "Q1P0", "Q2": "Q2Q1"}[name]):
        result = solve(
            "cook", MPI.COMM_SELF, kinematics="layer", element=key, cells=cells, nu=0.499
        )
        found[key] = result.steps[-1]["probes"]["corner"][1], result.notes
    (locked, notes), (free, none) = found.values()
    assert not none and [note["kind"] for note in notes] == ["locking"]
    assert free > 1.2 * locked
