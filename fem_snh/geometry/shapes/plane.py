"""The half-space below a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem_snh.geometry.shapes.shape import Array, Evaluation, Point, direction


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
