"""Deformation gradients, materials and checks for the tests at single points."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy
from scipy.spatial.transform import Rotation

from benchmarks.eigensolvers import stretches
from benchmarks.point_bounds import exactly
from benchmarks.pointwise import Oracle, oracle
from fem_snh import materials
from fem_snh.kernels.material import Material, material
from fem_snh.materials import registry
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import SIGMA
from fem_snh.materials.parameters import measures_of

#: Materials for the tests of the kernels, at nu below and above 0.4, where stable_neo_hookean
#: changes its form. The tests of every material are in test_every_material.py.
REPRESENTATIVE = ("stable_neo_hookean", "neo_hookean", "fixed_corotational")
NUS = (0.3, 0.49)
every_material = pytest.mark.parametrize(
    "m", [pytest.param((name, nu), id=f"{name}-{nu}") for name in REPRESENTATIVE for nu in NUS]
)
#: The materials whose stress is not the gradient of an energy.
NO_ENERGY = {"filtered_neo_hookean"}
every_name = pytest.mark.parametrize("name", materials.names())

#: Stretches in and out of the domain of energies that are infinite for inverted states.
STATES = {
    "random": (1.4, 0.9, 0.6),
    "stretched": (3.4, 0.6, 0.5),
    "nearly singular": (1.5, 1.2, 0.05),
    "inverted": (2.0, 1.2, -0.5),
    "all negative": (-2.0, -3.0, -5.0),
}


@lru_cache
def make(name: str, nu: float = 0.3, **shape: Any) -> Material:
    """Return a material with E = 1.7, so that a missing factor E changes the result."""
    return material(name, E=1.7, nu=nu, **shape)


def needs_stretches(name: str) -> bool:
    """Return whether an energy needs principal stretches: its arguments tell, without making it."""
    return bool({"I1", "s0"} & set(measures_of(registry.function(name))))


def exact(m: Material, F: Any) -> Oracle:
    """Return the material at F, computed with mpmath in its working precision."""
    return oracle(m.expression, exactly(F))


def rotations(n: int, seed: int = 0) -> np.ndarray:
    """Return n random rotations (n, 3, 3)."""
    return Rotation.random(n, random_state=seed).as_matrix()


def deformations(sigma: Any, seed: int = 0) -> np.ndarray:
    """Return random rotations times the stretches ``sigma`` (..., 3) times random rotations."""
    sigma = np.asarray(sigma, dtype=float)
    rows = sigma.reshape(-1, 3)
    U, V = rotations(len(rows), seed), rotations(len(rows), seed + 1)
    return ((U * rows[:, None, :]) @ np.swapaxes(V, 1, 2)).reshape(*sigma.shape, 3)


#: The pairs of stretches that twist and flip i couple.
PAIRS = ((1, 2), (0, 2), (0, 1))

#: Groups of 64 stretches each: regular, equal, nearly equal, signed, of very different sizes.
KINDS = stretches(64, seed=3)
every_kind = pytest.mark.parametrize("kind", list(KINDS))


def vec(A: np.ndarray) -> np.ndarray:
    """Return vec(A) by columns (Smith et al. 2018, eq. 17), (..., 3, 3) -> (..., 9)."""
    return np.swapaxes(A, -1, -2).reshape(*A.shape[:-2], 9)


def spread(A: np.ndarray) -> np.ndarray:
    """Return the largest absolute row sum of each matrix (..., n, n), a positive number."""
    return np.maximum(abs(A).sum(axis=-1).max(axis=-1), np.finfo(float).tiny)


def filtered(H: np.ndarray, filter: str) -> np.ndarray:
    """Return the filtered Hessian by numpy's eigendecomposition."""
    values, Q = np.linalg.eigh(H)
    values = np.maximum(values, 0) if filter == "clamp" else abs(values)
    return (Q * values[..., None, :]) @ np.swapaxes(Q, -1, -2)


def observed_order(h: np.ndarray, error: np.ndarray, floor: np.ndarray) -> float:
    """Return the slope of log error over log h, where the error is above rounding (``floor``)."""
    before = error > 30 * floor
    steps = int(np.argmin(before)) if not before.all() else len(h)
    assert steps >= 3, "rounding took over too early to see an order"
    return float(np.log2(error[steps - 2] / error[steps - 1]))


def is_outside_domain(m: Material, F: np.ndarray) -> bool:
    """Return whether psi(F) is infinite; assert that stress and Hessian are then zero."""
    outside = m.energy(F) == np.inf
    if outside:
        assert not m.pk1(F).any() and not m.hessian(F).any()
    return bool(outside)


@lru_cache
def principal(energy: Energy):
    """Return psi_i and psi_ij as functions of stretches and constants, by sympy, for mpmath."""
    first = energy.slopes
    if energy.has_energy:
        first = [sympy.diff(energy.psi_sigma, s) for s in SIGMA]
    second = [[sympy.diff(p, s) for s in SIGMA] for p in first]
    return sympy.lambdify((*SIGMA, *energy.constants), (first, second), "mpmath")


def exact_eigenvalues(m: Material, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return principal stresses and the Hessian's eigenvalues by sympy, in 60 digits."""
    with mpmath.workdps(60):
        # Equal stretches are separated by 1e-25: the divided difference is then the limit.
        s = [mpmath.mpf(float(x)) + k * mpmath.mpf(10) ** -25 for k, x in enumerate(s)]
        first, second = principal(m.expression)(*s, *m.expression.values)
        block = mpmath.matrix(second)
        scaling = sorted(mpmath.eigsy((block + block.T) / 2, eigvals_only=True), reverse=True)
        twist = [(first[j] + first[k]) / (s[j] + s[k]) for j, k in PAIRS]
        flip = [(first[j] - first[k]) / (s[j] - s[k]) for j, k in PAIRS]
        return np.array(first, float), np.array([*scaling, *twist, *flip], float)


def assert_eigenvalues(m: Material, s: np.ndarray, values: np.ndarray, bound: float) -> None:
    """Compare the eigenvalues with the exact ones, relative to the largest."""
    expected = exact_eigenvalues(m, s)[1]
    assert abs(values - expected).max() <= bound * abs(expected).max()
