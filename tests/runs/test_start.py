"""Where a run begins: states, on any number of ranks, and the scenes that begin in one."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Hold, cube, problem

import fem_snh
from fem_snh import scenes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.errors import BadInput
from fem_snh.problem.initial_state import set_initial_state
from fem_snh.scenes import Start

mpi = pytest.mark.mpi
ELEMENT = pytest.mark.parametrize("element", ["Q1", "P2", "Q2Q1"])


def begun(comm: MPI.Comm, element: str, start: Start, **conditions: Any) -> tuple[Any, Any, Any]:
    """A problem on a cube of 3 cells that has begun, and all its nodes in order: X, x."""
    p = problem(cube(comm, ELEMENTS[element].cell, 3), element, **conditions)
    set_initial_state(p, start)
    owned = p.V.dofmap.index_map.size_local
    X = p.V.tabulate_dof_coordinates()[:owned]
    x = X + p.x.array_r[: 3 * owned].reshape(-1, 3)
    X, x = (np.concatenate(comm.allgather(part)) for part in (X, x))
    order = np.lexsort(np.round(X, 6).T)
    return p, X[order], x[order]


@pytest.mark.one_debian
@mpi
@ELEMENT
def test_a_map(comm: MPI.Comm, element: str) -> None:
    matrix = ((1, 0.5, 0), (0, -1, 0), (0, 0, 0.2))
    _, X, x = begun(comm, element, Start(map=matrix))
    assert x == pytest.approx((X - 0.5) @ np.array(matrix).T + 0.5, abs=1e-12)
    _, X, x = begun(comm, element, Start(map=matrix, through=(0, 0, 1)))
    assert x == pytest.approx((X - [0, 0, 1]) @ np.array(matrix).T + [0, 0, 1], abs=1e-12)


@pytest.mark.one_debian("ranks")
@mpi
@ELEMENT
def test_a_scatter_fills_its_volume(comm: MPI.Comm, element: str) -> None:
    p, _, x = begun(comm, element, Start(scatter=8.0, seed=3))
    assert x.min() > -0.5 and x.max() < 1.5
    assert x.min(axis=0) == pytest.approx(-0.5, abs=0.3)  # 64 nodes or more
    assert x.max(axis=0) == pytest.approx(1.5, abs=0.3)
    assert x.mean(axis=0) == pytest.approx(0.5, abs=0.25)
    assert abs(np.corrcoef(x.T) - np.eye(3)).max() < 0.4
    if p.saddle_point:
        assert not p.saddle_point.pressure_dofs(p.x).any()


@mpi
@ELEMENT
@pytest.mark.parametrize("start", [Start(scatter=2.0, seed=1), Start(noise=1e-3, seed=1)])
def test_any_number_of_ranks_begins_the_same(comm: MPI.Comm, element: str, start: Start) -> None:
    _, X, x = begun(comm, element, start)
    _, alone, expected = begun(MPI.COMM_SELF, element, start)
    assert X == pytest.approx(alone, abs=1e-12)
    assert x == pytest.approx(expected, abs=1e-12)


def test_seeds_and_noise(comm: MPI.Comm) -> None:
    states = [begun(comm, "Q1", Start(scatter=2.0, seed=seed))[2] for seed in (0, 0, 1)]
    assert (states[0] == states[1]).all() and abs(states[0] - states[2]).min() > 0
    _, X, x = begun(comm, "Q1", Start(noise=0.01))
    assert 0.005 < abs(x - X).max() <= 0.01 and abs((x - X).mean()) < 0.003
    moved = begun(comm, "Q1", Start(scatter=2.0, noise=0.01))[2]
    assert abs(moved - states[0] - (x - X)).max() < 1e-12


@pytest.mark.one_debian("ranks")
@mpi
def test_prescribed_nodes_stay(comm: MPI.Comm) -> None:
    start = Start(scatter=2.0)
    _, X, x = begun(comm, "Q1", start, hold=[Hold("left"), Hold("right", ("z",))])
    left, right = X[:, 0] < 1e-9, X[:, 0] > 1 - 1e-9
    assert x[left] == pytest.approx(X[left]) and x[right, 2] == pytest.approx(X[right, 2])
    assert abs(x[right, :2] - X[right, :2]).min() > 0


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("start", {"map": np.eye(3).tolist(), "scatter": 2.0}, "start: 'map' and 'scatter'"),
        ("start", {"through": [0, 0, 0]}, "missing key 'map' or 'angular_velocity': expected with"),
        ("start", {"scater": 2.0}, "unknown key 'scater'.*scatter"),
        ("start.scatter", 0.0, "start.scatter = 0.0: expected a number > 0"),
        ("start.scatter", "all", "start.scatter = 'all'"),
        ("start.noise", -1.0, "start.noise = -1.0: expected a number >= 0"),
        ("start.seed", -1, "start.seed = -1: expected a whole number from 0 to"),
        ("start.map", [1, 2, 3], "start.map = .*a matrix"),
        ("predictor", "tangent", "predictor = 'tangent': expected 'none'"),
        ("nu_continuation", [0.5],
         r"nu_continuation = \[0.5\]: expected a list of Poisson's ratios in"),
        ("nu_continuation", 0.3, "nu_continuation = 0.3"),
    ],
)  # fmt: skip
def test_mistakes(key: str, value: Any, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        scenes.load("scramble", **{key: value})


# --- the scenes ----------------------------------------------------------------------------------


@mpi
@pytest.mark.parametrize("element", ["Q1", "P1"])
def test_a_scrambled_cube_is_back_at_rest(comm: MPI.Comm, element: str) -> None:
    result = fem_snh.run("scramble", cells=3, element=element, nu=0.3, comm=comm, progress=False)
    (step,) = result.steps
    assert result.converged and step["max_u"] < 1e-6 and step["newton"] > 5
    assert step["min_J"] == pytest.approx(1, abs=1e-5) and step["nonfinite"] == 0


def test_energies_that_are_not_finite_are_counted() -> None:
    """An inverted body, and an energy with a logarithm."""
    result = fem_snh.run("crush", to="inverted", material="neo_hookean", nu=0.3, progress=False)
    assert not result.converged and result.steps[0]["nonfinite"] == 1
    assert result.steps[0]["reason"] == "DIVERGED_FUNCTION_DOMAIN"


# --- by way of a softer material -----------------------------------------------------------------


def test_poisson_continuation_unfolds_what_a_plain_descent_does_not() -> None:
    """Scrambled cubes of tetrahedra at nu = 0.45: other minima, or home."""
    away = []
    for seed in range(4):
        given = {"cells": 4, "element": "P1", "nu": 0.45, "seed": seed, "progress": False}
        plain = fem_snh.run("scramble", hessian="adaptive", globalization="linesearch", **given)
        assert plain.converged
        away.append(plain.steps[-1]["max_u"] > 0.1 and plain.steps[-1]["energy"] > 0.01)
        soft = fem_snh.run("scramble", nu_continuation=[-0.3], **given)
        assert soft.converged and soft.steps[-1]["max_u"] < 1e-6
    assert any(away)
