"""The interface of a shape, and the simple shapes, such as `Box` and `Revolved`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fem_snh.arrays import Array
from fem_snh.errors import BadInput, bad_value, shown
from fem_snh.geometry.rotations import exponential

Point = tuple[float, float, float]


class Evaluation(NamedTuple):
    """The signed distance at n points, with its derivatives.

    Attributes
    ----------
    distance : (n,) array
        Signed distance [length]: positive outside of the shape, negative inside.
    gradient : (n, 3) array
        The gradient of the distance: the outward unit normal at the closest point of the surface.
        Only near the seams of a `SmoothUnion` it is shorter than 1.
    hessian : (n, 3, 3) array
        The second derivatives of the distance [1/length]: the curvature of the level set through
        the point.
    """

    distance: Array
    gradient: Array
    hessian: Array


class Shape:
    """A solid at its reference position, given by its signed distance.

    Notes
    -----
    The distance is not differentiable on the medial axis, where several points of the surface are
    closest. There the gradient is the normal at one of these points, the same one at each
    evaluation, and the second derivatives are zero in directions in which they do not exist.
    Outside of an edge or a corner the level sets are rounded; the Hessian is their curvature.
    """

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3), of a box around the shape; maybe infinite."""
        raise NotImplementedError(f"{type(self).__name__}.bounds")

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
        raise NotImplementedError(f"{type(self).__name__}.evaluate")

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        return self.evaluate(x).distance


def direction(key: str, vector: Sequence[float]) -> Array:
    """Return the unit vector (3,) along ``vector``, the value of ``key``.

    Raises
    ------
    BadInput
        If the vector is zero or not finite.
    """
    length = np.linalg.norm(vector)
    if not 0 < length < np.inf:
        raise bad_value(key, list(vector), "a vector that is not zero, of finite length")
    return np.asarray(vector, dtype=float) / length


def check_positive(key: str, value: float) -> None:
    """Raise BadInput unless ``value``, the value of ``key``, is positive and finite."""
    if not 0 < value < np.inf:
        raise bad_value(key, value, "a number > 0")


def around(points: Sequence[Point], margin: float | Array) -> Array:
    """Return the lowest coordinates of points minus a margin, and the highest plus it, (2, 3)."""
    return np.array([np.min(points, axis=0) - margin, np.max(points, axis=0) + margin])


def normalise(v: Array, otherwise: Array) -> tuple[Array, Array]:
    """Return the lengths (n,) and unit vectors of vectors (n, 3); ``otherwise`` (3,) for zero."""
    length = lengths(v)
    zero = length == 0.0
    unit = v / np.where(zero, 1.0, length)[:, None]
    unit[zero] = otherwise
    return length, unit


def lengths(v: Array) -> Array:
    """Return the lengths (n,) of vectors (n, dim)."""
    # Twice as fast as numpy.linalg.norm along short rows.
    return np.sqrt(np.einsum("ij,ij->i", v, v))


def inverse(length: Array) -> Array:
    """Return 1/length for lengths (n,); 0 for the length 0."""
    return np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)


def rotated(hessian: Array, R: Array) -> Array:
    """Return R H R^T (n, 3, 3) for symmetric matrices H (n, 3, 3) and a rotation R (3, 3)."""
    # Two products of tall matrices: ten times as fast as products of many small ones.
    half = (hessian.reshape(-1, 3) @ R.T).reshape(-1, 3, 3)
    return (half.swapaxes(1, 2).reshape(-1, 3) @ R.T).reshape(-1, 3, 3)


def outer(a: Array, b: Array) -> Array:
    """Return the outer products a b^T (n, 3, 3) of vectors (n, 3)."""
    return a[:, :, None] * b[:, None, :]


def deepest(depths: Array, tolerance: float) -> Array:
    """Return the index of the solid in which each point is deepest, (n,); -1 if in none.

    Parameters
    ----------
    depths : (solids, n) array
        Depths of the points in the solids [length]: negative outside, infinite in a group.
    tolerance : float
        Difference of depths that counts as zero. Points this far outside of a solid are in it, and
        a point equally deep in several solids is in the first one.
    """
    most = depths.max(axis=0)
    inside = most >= -tolerance
    # argmax: the first of those that are equally deep.
    first = np.argmax(depths >= np.where(inside, most - tolerance, -np.inf), axis=0)
    return np.asarray(np.where(inside, first, -1))


@dataclass(frozen=True)
class Box(Shape):
    """A rectangular box.

    Inside, the closest face gives the distance. On the medial axis, where several faces are equally
    close, the first one in the order x, y, z is used.

    Parameters
    ----------
    center : (3,) tuple
        The centre [length].
    size : (3,) tuple
        The lengths of the edges [length].
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
        return exponential(np.asarray(self.rotation))

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        return around([self.center], 0.5 * np.abs(self.axes) @ np.asarray(self.size))

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        y = (x - np.asarray(self.center)) @ self.axes
        q = np.abs(y) - 0.5 * np.asarray(self.size)
        return lengths(np.maximum(q, 0.0)) + np.minimum(q.max(axis=1), 0.0)

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
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
            np.where(outside, d, q.max(axis=1)), gradient @ axes.T, rotated(hessian, axes)
        )


@dataclass(frozen=True)
class Plane(Shape):
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

    @cached_property
    def _n(self) -> Array:
        """The unit normal."""
        return direction("normal", self.normal)

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        return np.array([[-np.inf] * 3, [np.inf] * 3])

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        return np.asarray((x - np.asarray(self.point)) @ self._n)

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
        normals = np.empty((len(x), 3))
        normals[:] = self._n
        return Evaluation(self.distance(x), normals, np.zeros((len(x), 3, 3)))


_X = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Sphere(Shape):
    r"""A ball, with signed distance :math:`d = |x - c| - r`.

    At the centre, the medial axis, the gradient is along x and the Hessian is zero.

    Parameters
    ----------
    center : (3,) tuple
        The centre c [length].
    radius : float
        The radius r [length].

    Raises
    ------
    BadInput
        For a radius that is not positive.
    """

    center: Point = (0.0, 0.0, 0.0)
    radius: float = 1.0

    def __post_init__(self) -> None:
        check_positive("radius", self.radius)

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        return around([self.center], self.radius)

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        return lengths(x - np.asarray(self.center)) - self.radius

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
        length, e = normalise(x - np.asarray(self.center), _X)
        hessian = (np.eye(3) - outer(e, e)) * inverse(length)[:, None, None]
        return Evaluation(length - self.radius, e, hessian)


@dataclass(frozen=True)
class _Segment(Shape):
    """The parameters of a `Capsule` or a `Cylinder`: a segment and a radius.

    Parameters
    ----------
    start, end : (3,) tuple
        The ends of the segment [length].
    radius : float
        The radius [length].

    Raises
    ------
    BadInput
        For a radius that is not positive, and ends that coincide.
    """

    start: Point
    end: Point
    radius: float

    def __post_init__(self) -> None:
        check_positive("radius", self.radius)
        _axis(self.start, self.end)


class Capsule(_Segment):
    """All points within a radius of a segment.

    On the segment, the medial axis, the gradient is a fixed normal of the segment.
    """

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        return around([self.start, self.end], self.radius)

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        t, _, length = _axis(self.start, self.end)
        arm = x - np.asarray(self.start)
        nearest = np.clip(arm @ t, 0.0, length)
        return lengths(arm - nearest[:, None] * t) - self.radius

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
        t, normal, length = _axis(self.start, self.end)
        arm = x - np.asarray(self.start)
        along = arm @ t
        nearest = np.clip(along, 0.0, length)
        rho, e = normalise(arm - nearest[:, None] * t, normal)
        on_side = (along == nearest)[:, None, None]
        # On the side one curvature is 1/rho, that along the segment is zero; the caps have both.
        flat = outer(e, e) + np.where(on_side, np.outer(t, t), 0.0)
        return Evaluation(rho - self.radius, e, (np.eye(3) - flat) * inverse(rho)[:, None, None])


@dataclass(frozen=True)
class Cylinder(_Segment):
    """A circular cylinder around a segment: with flat ends, or infinite.

    Inside, the side or the closer end gives the distance; if both are equally close, the side. On
    the axis the gradient of the side is a fixed normal of the axis.

    Parameters
    ----------
    infinite : bool
        Whether the cylinder extends infinitely beyond both ends.
    """

    infinite: bool = False

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        t, _, _ = _axis(self.start, self.end)
        margin = np.where(self.infinite, np.inf, self.radius * np.sqrt(1.0 - t**2))
        return around([self.start, self.end], margin)

    @cached_property
    def _solid(self) -> tuple[Revolved, Array, Array]:
        """The cylinder about the axis y, its axes as columns (3, 3), and its centre (3,)."""
        t, normal, length = _axis(self.start, self.end)
        r, depth = self.radius, 2 * max(2 * self.radius, length)  # along z no distance sees it
        half_plane = Plane((r, 0.0, 0.0), (1.0, 0.0, 0.0))
        section = half_plane if self.infinite else Box(size=(2 * r, length, depth))
        frame = np.stack([normal, t, np.cross(normal, t)], axis=1)
        return Revolved(section), frame, 0.5 * np.add(self.start, self.end)

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        solid, frame, centre = self._solid
        return solid.distance((x - centre) @ frame)

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
        solid, frame, centre = self._solid
        found = solid.evaluate((x - centre) @ frame)
        hessian = rotated(found.hessian, frame)
        return Evaluation(found.distance, found.gradient @ frame.T, hessian)


def _axis(start: Point, end: Point) -> tuple[Array, Array, float]:
    """Return the unit vector from start to end, a unit normal to this vector, and the length.

    Raises
    ------
    BadInput
        If the ends coincide or are not finite.
    """
    difference = np.subtract(end, start)
    length = float(np.linalg.norm(difference))
    if not 0 < length < np.inf:
        raise BadInput(f"to = {shown(list(end))}: expected a point other than 'from'")
    t = difference / length
    normal = np.cross(t, np.eye(3)[np.argmin(np.abs(t))])
    return t, normal / np.linalg.norm(normal), length


@dataclass(frozen=True)
class Revolved(Shape):
    r"""The solid of revolution about the axis y of a section in the half plane z = 0, x >= 0.

    With :math:`r = \sqrt{x^2 + z^2}` the signed distance is that of ``section`` at (r, y, 0).

    Parameters
    ----------
    section : Shape
        A shape whose part in the half plane is the section.
    """

    section: Shape

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        (_, low, _), (radius, high, _) = self.section.bounds
        return np.array([[-radius, low, -radius], [radius, high, radius]])

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        return self.section.distance(_in_half_plane(x))

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
        at = _in_half_plane(x)
        found = self.section.evaluate(at)
        # The unit vector e_r = (c, 0, s), and e_theta = (-s, 0, c).
        over_r = inverse(at[:, 0])
        c, s = np.where(at[:, 0] > 0, x[:, 0] * over_r, 1.0), x[:, 2] * over_r
        (g_r, g_y, _), H = found.gradient.T, found.hessian
        turning = g_r * over_r
        gradient = np.column_stack([g_r * c, g_y, g_r * s])
        hessian = np.empty((len(x), 3, 3))
        hessian[:, 0, 0] = H[:, 0, 0] * c**2 + turning * s**2
        hessian[:, 2, 2] = H[:, 0, 0] * s**2 + turning * c**2
        hessian[:, 0, 2] = hessian[:, 2, 0] = (H[:, 0, 0] - turning) * c * s
        hessian[:, 0, 1] = hessian[:, 1, 0] = H[:, 0, 1] * c
        hessian[:, 1, 2] = hessian[:, 2, 1] = H[:, 0, 1] * s
        hessian[:, 1, 1] = H[:, 1, 1]
        return Evaluation(found.distance, gradient, hessian)


def _in_half_plane(x: Array) -> Array:
    """Return points x (n, 3) turned about the axis y into the half plane: (r, y, 0)."""
    return np.column_stack([np.hypot(x[:, 0], x[:, 2]), x[:, 1], 0 * x[:, 2]])
