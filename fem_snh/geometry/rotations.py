"""Rotation matrices, and rotation vectors: axis times angle [rad]."""

from __future__ import annotations

import numpy as np

from fem_snh.arrays import Array

#: Angle [rad] below which a coefficient of `inverse_left_jacobian` is computed by its series, with
#: an error of the fourth power of the angle.
_SMALL = 1e-3


def skew(v: Array) -> Array:
    """Return the matrices [v]_x of vectors v (..., 3), with [v]_x a = v x a, (..., 3, 3)."""
    return np.cross(np.eye(3), np.asarray(v, dtype=float)[..., None, :])


def rigid_displacements(x: Array) -> Array:
    """Return displacements of points (n, 3): along, then about x, y, z with unit angle, (6, n, 3).

    The rotations are infinitesimal, about axes through the origin.
    """
    units = np.broadcast_to(np.eye(3)[:, None], (3, *x.shape))
    return np.concatenate([units, np.cross(units, x)])


def rotate(omega: Array, r: Array) -> Array:
    """Return vectors r (..., 3) rotated by rotation vectors (..., 3), by Rodrigues' formula."""
    angle = np.linalg.norm(omega, axis=-1, keepdims=True)
    first, second = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2
    once = np.cross(omega, r)
    return np.asarray(r + first * once + second * np.cross(omega, once))


def exponential(omega: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,)."""
    return rotate(omega, np.eye(3)).T


def nearest_rotation(A: Array) -> Array:
    """Return the rotations that are nearest to matrices A, (..., 3, 3) (Kabsch 1976)."""
    U, _, Vt = np.linalg.svd(A)
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def turn_about(axis: Array, R: Array) -> float:
    """Return the angle [rad] in [-pi, pi] of the rotation about a unit vector nearest to R."""
    axial = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(axis @ axial, np.trace(R) - axis @ R @ axis))


def inverse_left_jacobian(theta: Array) -> Array:
    """Return J^-1 (3, 3), with d theta/dt = J^-1 omega (Barfoot 2017, eq. 7.77).

    omega is the angular velocity, in global axes, of the rotation exp(theta).
    """
    angle = float(np.linalg.norm(theta))
    if angle < _SMALL:
        second = 1 / 12 + angle**2 / 720
    else:
        half = angle / 2
        second = (1 - half / np.tan(half)) / angle**2
    K = skew(theta)
    return np.asarray(np.eye(3) - K / 2 + second * (K @ K))
