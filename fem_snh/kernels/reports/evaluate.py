"""Evaluate a material at given principal stretches with the kernels of the assembly."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels.material import Material

Array = npt.NDArray[Any]


def diagonal(s: npt.ArrayLike) -> Array:
    """Return F = diag(s), shape (..., 3, 3), of stretches (..., 3)."""
    s = np.asarray(s, dtype=float)
    return s[..., None] * np.eye(3)


def inside(m: Material, F: Array) -> npt.NDArray[np.bool_]:
    """Return where the energy is finite, shape (...); everywhere for a material without one."""
    finite = (
        np.isfinite(m.energy(F)) if m.expression.has_energy else np.isfinite(F).all(axis=(-1, -2))
    )
    return np.asarray(finite)


def stress(m: Material, s: npt.ArrayLike) -> Array:
    """Return the diagonal of PK1 [Pa] at F = diag(s), (..., 3); NaN where psi is infinite."""
    F = diagonal(s)
    P = np.diagonal(m.pk1(F), axis1=-2, axis2=-1)
    return np.where(inside(m, F)[..., None], P, np.nan)


def eigenvalues(m: Material, s: npt.ArrayLike) -> Array:
    """Return the eigenvalues [Pa] of the tangent at F = diag(s), (..., 9); NaN likewise."""
    F = diagonal(s)
    return np.where(inside(m, F)[..., None], m.eigensystem(F)[0], np.nan)
