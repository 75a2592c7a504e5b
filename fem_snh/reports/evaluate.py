"""A material at given principal stretches, through the assembly's kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels.pointwise import Material

Array = npt.NDArray[Any]


def diagonal(s: npt.ArrayLike) -> Array:
    """F = diag(s), (..., 3) -> (..., 3, 3)."""
    s = np.asarray(s, dtype=float)
    return s[..., None] * np.eye(3)


def inside(m: Material, F: Array) -> npt.NDArray[np.bool_]:
    """Whether the energy is finite at F (..., 3, 3); everywhere for a material without one."""
    finite = (
        np.isfinite(m.energy(F)) if m.expression.has_energy else np.isfinite(F).all(axis=(-1, -2))
    )
    return np.asarray(finite)


def stress(m: Material, s: npt.ArrayLike) -> Array:
    """The diagonal of PK1 [Pa] at F = diag(s), (..., 3); NaN where the energy is infinite."""
    F = diagonal(s)
    P = np.diagonal(m.pk1(F), axis1=-2, axis2=-1)
    return np.where(inside(m, F)[..., None], P, np.nan)


def eigenvalues(m: Material, s: npt.ArrayLike) -> Array:
    """The nine eigenvalues [Pa] of the tangent at F = diag(s), (..., 9), likewise."""
    F = diagonal(s)
    return np.where(inside(m, F)[..., None], m.eigensystem(F)[0], np.nan)
