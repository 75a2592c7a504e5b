"""Shapes of revolution: sphere, capsule, cylinder, and any section about an axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem_snh.errors import BadInput, shown
from fem_snh.geometry.shapes.shape import (
    Array,
    Evaluation,
    Point,
    Shape,
    around,
    check_positive,
    inverse,
    lengths,
    normalise,
    outer,
)

_X = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Sphere:
    r"""A ball, with signed distance :math:`d = |x - c| - r`.

    Its medial axis is its centre, where the gradient is the x axis and the Hessian is zero.

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
        """Return the signed distance at points x (n, 3), with its gradient and its Hessian."""
        length, e = normalise(x - np.asarray(self.center), _X)
        hessian = (np.eye(3) - outer(e, e)) * inverse(length)[:, None, None]
        return Evaluation(length - self.radius, e, hessian)


@dataclass(frozen=True)
class _Segment:
    """A segment and a radius.

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

    Its medial axis is the segment, where the gradient is a fixed normal of the segment.
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
        """Return the signed distance at points x (n, 3), with its gradient and its Hessian."""
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

    Inside, the side or the end that is closer gives the distance. Its medial axis is the set
    where they are at the same distance (the side counts there), and its axis, where the gradient
    is a fixed normal of the axis.

    Parameters
    ----------
    infinite : bool
        Whether the cylinder goes on beyond both ends.
    """

    infinite: bool = False

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        t, _, _ = _axis(self.start, self.end)
        margin = np.where(self.infinite, np.inf, self.radius * np.sqrt(1.0 - t**2))
        return around([self.start, self.end], margin)

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        t, _, length = _axis(self.start, self.end)
        arm = x - 0.5 * (np.asarray(self.start) + np.asarray(self.end))
        along = arm @ t
        side = lengths(arm - along[:, None] * t) - self.radius
        if self.infinite:
            return side
        end = np.abs(along) - 0.5 * length
        beyond = np.hypot(np.maximum(side, 0.0), np.maximum(end, 0.0))
        distance: Array = beyond + np.minimum(np.maximum(side, end), 0.0)
        return distance

    def evaluate(self, x: Array) -> Evaluation:
        """Return the signed distance at points x (n, 3), with its gradient and its Hessian."""
        t, normal, length = _axis(self.start, self.end)
        arm = x - 0.5 * (np.asarray(self.start) + np.asarray(self.end))
        along = arm @ t
        rho, e = normalise(arm - along[:, None] * t, normal)
        side = rho - self.radius
        around = (np.eye(3) - outer(e, e) - np.outer(t, t)) * inverse(rho)[:, None, None]
        if self.infinite:
            return Evaluation(side, e, around)
        outward = np.where(along < 0, -1.0, 1.0)[:, None] * t
        end = np.abs(along) - 0.5 * length
        # In the plane through the axis the cylinder is a rectangle: distances (side, end) from
        # its edges. Beyond both, its corner is closest, which is the rim.
        rim = (side > 0) & (end > 0)
        on_side = side >= end
        distance = np.where(on_side, side, end)
        gradient = np.where(on_side[:, None], e, outward)
        hessian = np.where(on_side[:, None, None], around, 0.0)
        d = np.hypot(side[rim], end[rim])
        a, b = side[rim] / d, end[rim] / d
        g = a[:, None] * e[rim] + b[:, None] * outward[rim]
        across = b[:, None] * e[rim] - a[:, None] * outward[rim]
        distance[rim], gradient[rim] = d, g
        # The rim is a circle: 1/d in the plane through the axis, a/rho around the axis.
        hessian[rim] = outer(across, across) / d[:, None, None] + a[:, None, None] * around[rim]
        return Evaluation(distance, gradient, hessian)


def _axis(start: Point, end: Point) -> tuple[Array, Array, float]:
    """Return the unit vector from start to end, a normal of it, and the length.

    Raises
    ------
    BadInput
        If the ends coincide.
    """
    difference = np.subtract(end, start)
    length = float(np.linalg.norm(difference))
    if not 0 < length < np.inf:
        raise BadInput(f"to = {shown(list(end))}: expected a point other than 'from'")
    t = difference / length
    normal = np.cross(t, np.eye(3)[np.argmin(np.abs(t))])
    return t, normal / np.linalg.norm(normal), length


@dataclass(frozen=True)
class Revolved:
    r"""The solid of revolution about the axis y of a section in the half plane z = 0, x >= 0.

    With :math:`r = \sqrt{x^2 + z^2}` its distance is that of the section at (r, y, 0).

    Parameters
    ----------
    section : Shape
        The section.
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
        """Return the signed distance at points x (n, 3), with its gradient and its Hessian."""
        at = _in_half_plane(x)
        found = self.section.evaluate(at)
        radial = np.where(at[:, [0]] > 0, x * inverse(at[:, 0])[:, None], [1.0, 0.0, 0.0])
        radial[:, 1] = 0.0
        turn = np.cross(radial, [0.0, 1.0, 0.0])
        #: The directions e_r, e_y, e_theta as rows.
        frame = np.stack([radial, np.broadcast_to([0.0, 1.0, 0.0], x.shape), turn], axis=1)
        hessian = found.hessian.copy()
        hessian[:, 2, 2] = found.gradient[:, 0] * inverse(at[:, 0])
        return Evaluation(
            found.distance,
            np.einsum("nai,na->ni", frame, found.gradient),
            np.einsum("nai,nab,nbj->nij", frame, hessian, frame),
        )


def _in_half_plane(x: Array) -> Array:
    """Return points x (n, 3) turned about the axis into the half plane z = 0."""
    return np.column_stack([np.hypot(x[:, 0], x[:, 2]), x[:, 1], 0 * x[:, 2]])
