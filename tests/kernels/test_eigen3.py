"""The two 3x3 eigensolvers of eigen3.h, and the comparison of docs/results/eigensolver.md."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from points import KINDS, every_kind, make, rotations, spread

from benchmarks import eigensolvers as study
from fem_snh.choices import EIGENSOLVERS
from fem_snh.kernels.material import eigen3

pytestmark = pytest.mark.one_debian

each_solver = pytest.mark.parametrize("solver", EIGENSOLVERS)
MATERIALS = [make("stable_neo_hookean", nu) for nu in (0.49, 0.3)]


def check(A: np.ndarray, solver: str, bound: float = 6e-15) -> None:
    """Order, orthonormality, A = Q diag(e) Q^T and numpy's eigenvalues, to rounding of the norm."""
    e, Q = eigen3(A, solver)
    size = spread(A)
    assert np.all(np.diff(e, axis=-1) <= 1e-15 * size[..., None])
    assert abs(np.swapaxes(Q, -1, -2) @ Q - np.eye(3)).max() <= bound
    scaled = A / size[..., None, None]
    error = (Q * (e / size[..., None])[..., None, :]) @ np.swapaxes(Q, -1, -2) - scaled
    assert abs(error).max() <= bound
    assert abs(e[..., ::-1] / size[..., None] - np.linalg.eigvalsh(scaled)).max() <= bound


def symmetric(entries: np.ndarray) -> np.ndarray:
    """(..., 6) -> (..., 3, 3)"""
    return entries[..., [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]


rng = np.random.default_rng(11)
anything = rng.standard_normal((2000, 6))
tiny = 10.0 ** rng.uniform(-18, 0, (2000, 1))
HARD = {
    "random": anything,
    "any size": anything * 10.0 ** rng.uniform(-290, 290, (2000, 1)),
    "denormal": anything * 1e-310,
    "graded": anything * 10.0 ** rng.uniform(-8, 8, (2000, 6)),
    "nearly diagonal": anything * [1, 1, 1, 1e-9, 1e-9, 1e-9],
    "nearly a multiple of I": np.array([1, 1, 1, 0, 0, 0]) + tiny * anything,
    "two nearly equal": anything[:, [0, 0, 1, 3, 3, 3]] * [1, 1, 1, 0, 0, 0] + tiny * anything,
    "rank one": anything[:, [0, 1, 2, 0, 0, 1]] * anything[:, [0, 1, 2, 1, 2, 2]],
    "multiples of I": np.array([1, 1, 1, 0, 0, 0]) * anything[:, :1],
}


@each_solver
@pytest.mark.parametrize("kind", list(HARD))
def test_hard_matrices(kind, solver):
    check(symmetric(HARD[kind]), solver, 1e-13 if kind == "denormal" else 6e-15)


@each_solver
@every_kind
def test_scaling_blocks(kind, solver):
    for m in MATERIALS:
        check(study.blocks(m, KINDS[kind]), solver)


@each_solver
def test_zero_and_not_finite(solver):
    e, Q = eigen3(np.zeros((3, 3)), solver)
    assert np.array_equal(e, np.zeros(3))
    assert abs(Q.T @ Q - np.eye(3)).max() <= 1e-15
    _, Q = eigen3(np.full((3, 3), np.nan), solver)
    assert np.isfinite(Q).all()


def test_jacobi_keeps_the_digits_of_graded_matrices():
    """What only it can: D C D (C well-conditioned, D graded) to relative accuracy."""
    rng = np.random.default_rng(4)
    Q, D = rotations(30, 2), 10.0 ** rng.uniform(-8, 8, (30, 3))
    A = (Q * rng.uniform(0.5, 2, (30, 1, 3))) @ np.swapaxes(Q, 1, 2) * D[:, :, None] * D[:, None, :]
    A = (A + np.swapaxes(A, 1, 2)) / 2
    with mpmath.workdps(60):
        rows = [mpmath.eigsy(mpmath.matrix(a.tolist()), eigvals_only=True) for a in A]
        exact = np.array([[float(x) for x in row] for row in rows])
    found, _ = eigen3(A, "jacobi")
    assert abs(found[:, ::-1] / exact - 1).max() <= 1e-13


# --- the comparison ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def records() -> list[dict]:
    return list(study.rows(samples=12, points=800))


def test_both_of_ours_are_exact_and_the_printed_formulas_are_not(records):
    for r in records:
        assert r["cubic_error"] < 2e-15, r["stretches"]
        assert r["jacobi_error"] < 2e-15, r["stretches"]
    # As printed the cubic gives 14 digits at well separated stretches, none at equal ones.
    printed = {r["stretches"]: r["printed_error"] for r in records}
    assert printed["random in -2..2"] < 1e-10
    assert printed["small strain, differences 1e-4..1e-16"] > 1e-3
    assert not printed["all equal, 1e-8..1e8"] < 1
