"""Deformation gradients and materials for the tests at single points."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.eigensolvers import stretches
from fem_snh import materials
from fem_snh.kernels.pointwise import Material, material

#: Materials by which the machinery is tested, on both sides of nu = 0.4, where the first changes;
#: what is asked of each and every material is in test_every_material.py.
REPRESENTATIVE = ("stable_neo_hookean", "neo_hookean", "fixed_corotational")
NUS = (0.3, 0.49)
every_material = pytest.mark.parametrize(
    "m", [pytest.param((name, nu), id=f"{name}-{nu}") for name in REPRESENTATIVE for nu in NUS]
)
every_name = pytest.mark.parametrize("name", materials.names())

#: Stretches in and out of the domain of energies that are infinite for inverted states.
STATES = {
    "random": (1.4, 0.9, 0.6),
    "stretched": (3.4, 0.6, 0.5),
    "flat": (1.5, 1.2, 0.05),
    "inverted": (2.0, 1.2, -0.5),
    "everted": (-2.0, -3.0, -5.0),
}


@lru_cache
def law(name: str, nu: float, **shape: Any) -> Material:
    """A material with E = 1.7 (so that a forgotten E is seen)."""
    return material(name, E=1.7, nu=nu, **shape)


def rotations(n: int, seed: int = 0) -> np.ndarray:
    """n random rotations (n, 3, 3)."""
    return Rotation.random(n, random_state=seed).as_matrix()


def deformations(sigma: Any, seed: int = 0) -> np.ndarray:
    """Random rotations times the stretches ``sigma`` (..., 3) times random rotations."""
    sigma = np.asarray(sigma, dtype=float)
    flat = sigma.reshape(-1, 3)
    U, V = rotations(len(flat), seed), rotations(len(flat), seed + 1)
    return ((U * flat[:, None, :]) @ np.swapaxes(V, 1, 2)).reshape(*sigma.shape, 3)


KINDS = stretches(64, seed=3)
every_kind = pytest.mark.parametrize("kind", list(KINDS))


def vec(A: np.ndarray) -> np.ndarray:
    """vec(A) by columns (paper, eq. 17), (..., 3, 3) -> (..., 9)."""
    return np.swapaxes(A, -1, -2).reshape(*A.shape[:-2], 9)


def spread(A: np.ndarray) -> np.ndarray:
    """The norm of each matrix of (..., n, n): its largest absolute row sum, at least tiny."""
    return np.maximum(abs(A).sum(axis=-1).max(axis=-1), np.finfo(float).tiny)


def filtered(H: np.ndarray, filter: str) -> np.ndarray:
    """numpy's answer to a filter."""
    values, Q = np.linalg.eigh(H)
    values = np.maximum(values, 0) if filter == "clamp" else abs(values)
    return (Q * values[..., None, :]) @ np.swapaxes(Q, -1, -2)


def observed_order(h: np.ndarray, error: np.ndarray, floor: np.ndarray) -> float:
    """The slope of log error over log h before rounding (``floor``) takes over."""
    before = error > 30 * floor
    steps = int(np.argmin(before)) if not before.all() else len(h)
    assert steps >= 3, "rounding took over too early to see an order"
    return float(np.log2(error[steps - 2] / error[steps - 1]))
