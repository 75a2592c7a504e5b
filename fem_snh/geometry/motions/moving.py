"""Rigid motions of obstacles: their pose at a load, and what a point of theirs moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from fem_snh.geometry.shapes.shape import Array, Evaluation, Shape


class Pose(NamedTuple):
    """A rigid map x = R X + c.

    Attributes
    ----------
    rotation : (3, 3) array
        R, with R^T R = I and det R = 1.
    translation : (3,) array
        c [length].
    """

    rotation: Array
    translation: Array

    def apply(self, X: Array) -> Array:
        """Return the points R X + c (n, 3)."""
        x: Array = X @ self.rotation.T + self.translation
        return x

    def invert(self, x: Array) -> Array:
        """Return the points R^T (x - c) (n, 3)."""
        X: Array = (x - self.translation) @ self.rotation
        return X


class RigidMotion(Protocol):
    """A rigid motion as a function of the load."""

    def pose(self, load: float) -> Pose:
        """Return the pose at a load from 0 to 1."""


@dataclass(frozen=True)
class DisplacementMotion:
    """A rigid motion that a displacement field defines, as the scene's ``[[move]]`` has it.

    Parameters
    ----------
    displacement : callable
        The displacements (n, 3) of reference points X (n, 3) at a load: ``displacement(X, load)``.
    """

    displacement: Callable[[Array, float], Array]

    def pose(self, load: float) -> Pose:
        """Return the pose at a load from 0 to 1."""
        # The rotation does not depend on the place: the images of the origin and of the axes.
        X = np.vstack([np.zeros(3), np.eye(3)])
        x = X + self.displacement(X, load)
        return Pose((x[1:] - x[0]).T, x[0])


@dataclass(frozen=True)
class Obstacle:
    """A rigid shape in motion.

    Parameters
    ----------
    shape : Shape
        The shape at its reference position.
    motion : RigidMotion, optional
        Its motion; without one it does not move.

    Notes
    -----
    Its distance moves with it: :math:`d(x, \\lambda) = d(R^T(x - c))`, with gradient
    :math:`R\\,\\nabla d` and Hessian :math:`R\\,\\nabla^2 d\\,R^T`.
    """

    shape: Shape
    motion: RigidMotion | None = None

    def pose(self, load: float) -> Pose:
        """Return the pose at a load: R (3, 3) and c (3,) [length] of x = R X + c."""
        if self.motion is None:
            return Pose(np.eye(3), np.zeros(3))
        return self.motion.pose(load)

    def affine(self, load: float) -> list[list[float]]:
        """Return the pose as the three rows [R | c] of a 3x4 matrix, as run.json has it."""
        R, c = self.pose(load)
        return [list(map(float, row)) for row in np.column_stack([R, c])]

    def evaluate(self, x: Array, load: float) -> Evaluation:
        """Return the signed distance of points at a load, with its derivatives.

        Parameters
        ----------
        x : (n, 3) array
            Points [length].
        load : float
            The load, from 0 to 1.

        Returns
        -------
        Evaluation
            distance (n,) [length], positive outside; gradient (n, 3); hessian (n, 3, 3) [1/length].
        """
        if self.motion is None:
            return self.shape.evaluate(x)
        pose = self.pose(load)
        R = pose.rotation
        distance, gradient, hessian = self.shape.evaluate(pose.invert(x))
        return Evaluation(distance, gradient @ R.T, R @ hessian @ R.T)

    def displacement(self, x: Array, start: float, end: float) -> Array:
        """Return what points that move with the obstacle are displaced between two loads.

        Parameters
        ----------
        x : (n, 3) array
            Where the points are at the load ``start`` [length].
        start, end : float
            The loads; ``end`` may be the lower one.

        Returns
        -------
        (n, 3) array
            Displacements [length], from ``start`` to ``end``.
        """
        if self.motion is None or start == end:
            return np.zeros_like(x, dtype=float)
        return self.pose(end).apply(self.pose(start).invert(x)) - x
