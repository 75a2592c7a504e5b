"""The interface of a shape, and what the shapes share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from fem_snh.errors import bad_value

Array = npt.NDArray[Any]
Point = tuple[float, float, float]


class Evaluation(NamedTuple):
    """The signed distance at n points, with its derivatives.

    Attributes
    ----------
    distance : (n,) array
        Signed distance [length]: positive outside of the shape, negative inside.
    gradient : (n, 3) array
        Its gradient, of length 1: the outward normal at the closest point of the surface; shorter
        only near the seams of a `SmoothUnion`.
    hessian : (n, 3, 3) array
        Its second derivatives [1/length], the curvature of the level set through the point.
    """

    distance: Array
    gradient: Array
    hessian: Array


class Shape(Protocol):
    """A solid at its reference position, given by its signed distance.

    Notes
    -----
    The distance is not differentiable on the medial axis, where several points of the surface are
    closest. There the gradient is that of one of them, the same one at each evaluation, and the
    second derivatives are zero in the directions in which they do not exist. Outside of an edge
    or a corner the level sets are rounded, and the derivatives are those of the rounded surface.
    """

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3), of a box that holds the shape; maybe infinite."""

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""

    def evaluate(self, x: Array) -> Evaluation:
        """Return the signed distance at points x (n, 3), with its gradient and its Hessian."""


def direction(key: str, vector: Sequence[float]) -> Array:
    """Return the unit vector of a direction.

    Raises
    ------
    BadInput
        If it is zero or not finite.
    """
    length = np.linalg.norm(vector)
    if not 0 < length < np.inf:
        raise bad_value(key, list(vector), "a vector that is not zero, of finite length")
    unit: Array = np.asarray(vector, dtype=float) / length
    return unit


def check_positive(key: str, value: float) -> None:
    """Raise BadInput unless a length is positive and finite."""
    if not 0 < value < np.inf:
        raise bad_value(key, value, "a number > 0")


def around(points: Sequence[Point], margin: float | Array) -> Array:
    """Return lowest and highest coordinates, (2, 3), of points enlarged by a margin."""
    bounds: Array = np.array([np.min(points, axis=0) - margin, np.max(points, axis=0) + margin])
    return bounds


def normalise(v: Array, otherwise: Array) -> tuple[Array, Array]:
    """Return the lengths (n,) of vectors (n, 3) and their directions; ``otherwise`` for zero."""
    length = lengths(v)
    zero = length == 0.0
    unit = v / np.where(zero, 1.0, length)[:, None]
    unit[zero] = otherwise
    return length, unit


def lengths(v: Array) -> Array:
    """Return the lengths (n,) of vectors (n, 3)."""
    # Twice as fast as numpy.linalg.norm along short rows.
    found: Array = np.sqrt(np.einsum("ij,ij->i", v, v))
    return found


def inverse(length: Array) -> Array:
    """Return 1/length, and zero for zero."""
    return np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)


def outer(a: Array, b: Array) -> Array:
    """Return the matrices (n, 3, 3) of the outer products of vectors (n, 3)."""
    product: Array = a[:, :, None] * b[:, None, :]
    return product


def deepest(depths: Array, tolerance: float) -> Array:
    """Return the solid in which each point is deepest, (n,); -1: in none.

    Parameters
    ----------
    depths : (solids, n) array
        How deep the points are in the solids [length]; negative outside, infinite in a group.
    tolerance : float
        Difference of depths that counts as none: a point that is equally deep in several solids is
        in the first of them.
    """
    most = depths.max(axis=0)
    inside = most >= -tolerance
    # argmax: the first of those that are equally deep.
    first = np.argmax(depths >= np.where(inside, most - tolerance, -np.inf), axis=0)
    return np.asarray(np.where(inside, first, -1))
