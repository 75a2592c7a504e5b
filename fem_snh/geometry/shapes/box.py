"""Flat shapes: a box with edges parallel to the axes, or turned, and the half-space of a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem_snh.geometry.shapes.shape import (
    Array,
    Evaluation,
    Point,
    around,
    check_positive,
    direction,
    inverse,
    lengths,
    outer,
)


@dataclass(frozen=True)
class Box:
    """A rectangular box.

    Inside, the closest face gives the distance; its medial axis is the set where several faces
    are at the same distance, and the first of them in the order x, y, z counts there.

    Parameters
    ----------
    center : (3,) tuple
        The centre [length].
    size : (3,) tuple
        The lengths of its edges [length].
    rotation : (3,) tuple
        Rotation vector about the centre: the axis, times the angle [rad].

    Raises
    ------
    BadInput
        For a size that is not positive.
    """

    center: Point = (0.0, 0.0, 0.0)
    size: Point = (1.0, 1.0, 1.0)
    rotation: Point = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for length in self.size:
            check_positive("size", length)

    @property
    def axes(self) -> Array:
        """The rotation matrix (3, 3); its columns are the directions of the edges."""
        if not any(self.rotation):
            return np.eye(3)
        from scipy.spatial.transform import Rotation

        matrix: Array = Rotation.from_rotvec(self.rotation).as_matrix()
        return matrix

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        return around([self.center], 0.5 * np.abs(self.axes) @ np.asarray(self.size))

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        y = (x - np.asarray(self.center)) @ self.axes
        q = np.abs(y) - 0.5 * np.asarray(self.size)
        distance: Array = lengths(np.maximum(q, 0.0)) + np.minimum(q.max(axis=1), 0.0)
        return distance

    def evaluate(self, x: Array) -> Evaluation:
        """Return the signed distance at points x (n, 3), with its gradient and its Hessian."""
        axes = self.axes
        y = (x - np.asarray(self.center)) @ axes
        sign = np.where(y < 0, -1.0, 1.0)
        q = np.abs(y) - 0.5 * np.asarray(self.size)  # signed distances from the pairs of faces
        beyond = q > 0
        outside = beyond.any(axis=1)
        excess = np.where(beyond, q, 0.0)
        d = np.linalg.norm(excess, axis=1)
        face = np.eye(3)[np.argmax(q, axis=1)]
        gradient = sign * np.where(outside[:, None], excess * inverse(d)[:, None], face)
        # Beyond k faces the closest point is on a face, an edge or a corner: k - 1 curvatures 1/d.
        flat = beyond[:, :, None] * np.eye(3) - outer(gradient, gradient)
        several = (beyond.sum(axis=1) > 1)[:, None, None]
        hessian = np.where(several, flat * inverse(d)[:, None, None], 0.0)
        return Evaluation(
            np.where(outside, d, q.max(axis=1)), gradient @ axes.T, axes @ hessian @ axes.T
        )


@dataclass(frozen=True)
class Plane:
    r"""The half-space below a plane, with signed distance :math:`d = (x - p) \cdot n`.

    Parameters
    ----------
    point : (3,) tuple
        A point p of the plane [length].
    normal : (3,) tuple
        The direction out of the obstacle; its length does not matter.

    Raises
    ------
    BadInput
        For a normal of length zero.
    """

    point: Point = (0.0, 0.0, 0.0)
    normal: Point = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        direction("normal", self.normal)

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        return np.array([[-np.inf] * 3, [np.inf] * 3])

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        distance: Array = (x - np.asarray(self.point)) @ direction("normal", self.normal)
        return distance

    def evaluate(self, x: Array) -> Evaluation:
        """Return the signed distance at points x (n, 3), with its gradient and its Hessian."""
        n = direction("normal", self.normal)
        return Evaluation(self.distance(x), np.tile(n, (len(x), 1)), np.zeros((len(x), 3, 3)))
