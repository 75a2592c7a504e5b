"""Triangles of the surfaces of shapes, for files and pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fem_snh.geometry.shapes.closed_surface import ClosedSurface
from fem_snh.geometry.shapes.polygon import Polygon
from fem_snh.geometry.shapes.shape import Array, Box, Capsule, Cylinder, Plane, Shape, Sphere
from fem_snh.geometry.shapes.unions import SmoothUnion, Union
from fem_snh.geometry.surface_nets import CORNERS, Grid, surface_on

Triangles = npt.NDArray[np.integer]

#: Cubes along the longest edge of the box in which a smooth union is triangulated.
_CUBES = 40
#: Edges of the polygon that replaces a circle: it is inside by up to 0.2 % of the radius.
_CIRCLE = 48


def surface_triangles(
    shape: Shape,
    centre: Array,
    radius: float,
) -> tuple[Array, Triangles]:
    """Return points (n, 3) [length] and triangles (m, 3) of a shape's surface.

    Parameters
    ----------
    shape : Shape
        The shape at its reference position.
    centre : (3,) array
        The centre [length] of a ball outside of which infinite surfaces are cut off. The seams of
        an infinite smooth union are left sharp.
    radius : float
        The radius [length] of the ball.

    Raises
    ------
    TypeError
        For a shape of another class, such as `Revolved`.
    """
    if isinstance(shape, SmoothUnion) and np.isfinite(shape.bounds).all():
        grid = Grid.around(shape.bounds, float(np.ptp(shape.bounds, axis=0).max()) / _CUBES)
        return surface_on(shape, Grid(grid.origin - grid.size, grid.size, grid.shape + 2))
    if isinstance(shape, Union):
        return join([surface_triangles(part, centre, radius) for part in shape.shapes])
    if isinstance(shape, ClosedSurface):
        return shape.points, shape.triangles
    if isinstance(shape, Plane):
        n = np.asarray(shape.normal) / np.linalg.norm(shape.normal)
        foot = centre - n * ((centre - shape.point) @ n)
        a, b = _across(n)
        corners = [foot + radius * (i * a + j * b) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        return np.array(corners), np.array([[0, 1, 2], [0, 2, 3]])
    if isinstance(shape, Box):
        return _box(shape)
    if isinstance(shape, Polygon):
        return _prism(shape.corners, centre[2], radius)
    if isinstance(shape, Sphere):
        return _revolved(np.asarray(shape.center), np.eye(3)[2], *_arc(shape.radius, 0.0))
    if isinstance(shape, Capsule | Cylinder):
        start, end = np.asarray(shape.start, float), np.asarray(shape.end, float)
        length = float(np.linalg.norm(end - start))
        axis = (end - start) / length
        if isinstance(shape, Capsule):
            return _revolved(start, axis, *_arc(shape.radius, length))
        if shape.infinite:
            start = start + axis * ((centre - start) @ axis - radius)
            return _revolved(start, axis, np.array([0.0, 2 * radius]), np.full(2, shape.radius))
        heights, radii = np.array([[0.0, 0.0, length, length], [0.0, *[shape.radius] * 2, 0.0]])
        return _revolved(start, axis, heights, radii)
    raise TypeError(f"no triangles of a {type(shape).__name__}")


def join(parts: Sequence[tuple[Array, Triangles]]) -> tuple[Array, Triangles]:
    """Return the points and triangles of several surfaces as those of one surface."""
    first = np.cumsum([0, *(len(points) for points, _ in parts[:-1])])
    points = np.concatenate([points for points, _ in parts])
    return points, np.concatenate([t + n for (_, t), n in zip(parts, first, strict=True)])


def _arc(radius: float, length: float) -> tuple[Array, Array]:
    """Return the heights and radii (k,) of a capsule's profile, from pole to pole."""
    angle = np.linspace(-0.5, 0.5, _CIRCLE // 2 + 2) * np.pi  # an even number of points
    height = radius * np.sin(angle)
    return np.where(angle > 0, height + length, height), radius * np.cos(angle)


def _revolved(origin: Array, axis: Array, height: Array, radius: Array) -> tuple[Array, Triangles]:
    """Return points and triangles of the surface of revolution of a profile about an axis.

    The heights (k,) of the profile are along the unit vector ``axis`` from ``origin``.
    """
    a, b = _across(axis)
    angle = 2 * np.pi * np.arange(_CIRCLE) / _CIRCLE
    around = np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b
    points = origin + height[:, None, None] * axis + radius[:, None, None] * around
    i, j = (k.ravel() for k in np.indices((len(height) - 1, _CIRCLE)))
    corner = [
        _CIRCLE * (i + di) + (j + dj) % _CIRCLE for di, dj in ((0, 0), (0, 1), (1, 1), (1, 0))
    ]
    p, q, r, s = corner
    triangles = np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)])
    x = points.reshape(-1, 3)
    edges = x[triangles[:, 1:]] - x[triangles[:, :1]]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return x, triangles[area > 1e-12 * area.max()]  # without those at the poles


def _prism(corners: Array, height: float, radius: float) -> tuple[Array, Triangles]:
    """Return points and triangles of a prism's sides, z = height +- radius.

    ``corners`` (m, 2) of the polygon are anticlockwise; then the triangles are outward.
    """
    m = len(corners)
    ends = [np.column_stack([corners, np.full(m, height + z)]) for z in (-radius, radius)]
    i = np.arange(m)
    j = (i + 1) % m
    sides = [np.stack([i, j, j + m], axis=1), np.stack([i, j + m, i + m], axis=1)]
    return np.concatenate(ends), np.concatenate(sides)


def _box(box: Box) -> tuple[Array, Triangles]:
    """Return the corners (8, 3) and triangles (12, 3) of a box."""
    points = np.asarray(box.center) + (CORNERS - 0.5) * box.size @ box.axes.T
    faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
    return points, np.array([[f[0], f[i], f[i + 1]] for f in faces for i in (1, 2)])


def _across(axis: Array) -> tuple[Array, Array]:
    """Return unit vectors a, b such that (a, b, axis) is a right-handed orthonormal basis."""
    a = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    a /= np.linalg.norm(a)
    return a, np.cross(axis, a)
