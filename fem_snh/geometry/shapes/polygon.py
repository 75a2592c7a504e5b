"""A polygon in the plane (x, y), and in three dimensions the infinite prism over it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fem_snh.arrays import Array
from fem_snh.errors import bad_value
from fem_snh.geometry.shapes.shape import Evaluation, Shape, inverse, lengths

#: Distance over the polygon's largest extent below which the direction to the closest point is
#: rounding error, and the normal of the edge is used.
_ON_EDGE = 1e-10
#: Largest distance from 0 or 1 of the parameter of a point on an edge that counts as a corner.
_AT_END = 1e-12


@dataclass(frozen=True)
class Polygon(Shape):
    r"""All points (x, y, z) whose (x, y) is inside of a polygon.

    Outside of a corner the level sets are circles of curvature 1/d. On the medial axis the first of
    the closest edges is used.

    Parameters
    ----------
    points : tuple of (2,) tuples
        The corners in turn, clockwise or not; the last edge leads back to the first [length].

    Raises
    ------
    BadInput
        For fewer than three corners, an edge of no length, edges that cross, or no area.
    """

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        x = np.array(self.points, dtype=float)
        simple = "three or more corners of a polygon whose edges do not meet elsewhere"
        if len(x) < 3 or not lengths(np.roll(x, -1, axis=0) - x).all() or _crosses(x):
            raise bad_value("points", [list(p) for p in self.points], simple)

    @cached_property
    def corners(self) -> Array:
        """The corners in anticlockwise order, (m, 2) [length]."""
        x = np.array(self.points, dtype=float)
        after = np.roll(x, -1, axis=0)
        area = (x[:, 0] * after[:, 1] - after[:, 0] * x[:, 1]).sum()
        return x[::-1] if area < 0 else x

    @cached_property
    def _edges(self) -> tuple[Array, Array, Array]:
        """Starts, vectors from start to end, and outward unit normals of the edges, (m, 2) each.

        The edges are in anticlockwise order.
        """
        x = self.corners
        way = np.roll(x, -1, axis=0) - x
        normal = np.column_stack([way[:, 1], -way[:, 0]]) / lengths(way)[:, None]
        return x, way, normal

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        x = np.array(self.points, dtype=float)
        return np.array([[*x.min(axis=0), -np.inf], [*x.max(axis=0), np.inf]])

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
        start, way, normal = self._edges
        p = x[:, None, :2] - start
        t = np.clip(np.einsum("nmi,mi->nm", p, way) / (way**2).sum(axis=1), 0.0, 1.0)
        arms = p - t[..., None] * way
        squares = np.einsum("nmi,nmi->nm", arms, arms)
        row, edge = np.arange(len(x)), squares.argmin(axis=1)
        arm, at, length = arms[row, edge], t[row, edge], np.sqrt(squares[row, edge])
        # At a corner the sign is that of the sum of both normals (Baerentzen & Aanaes 2005).
        other = np.where(at < 0.5, edge - 1, (edge + 1) % len(way))
        corner = (at < _AT_END) | (at > 1 - _AT_END)
        pseudo = normal[edge] + np.where(corner[:, None], normal[other], 0.0)
        sign = np.where((arm * pseudo).sum(axis=1) < 0, -1.0, 1.0)
        far = length > _ON_EDGE * float(np.ptp(start, axis=0).max())
        flat = np.where(far[:, None], sign[:, None] * arm * inverse(length)[:, None], normal[edge])
        gradient = np.zeros((len(x), 3))
        gradient[:, :2] = flat
        hessian = np.zeros((len(x), 3, 3))
        # The level sets around a corner are circles; a reentrant one has them inside.
        curved = (np.eye(2) - flat[:, :, None] * flat[:, None]) * (sign * inverse(length))[
            :, None, None
        ]
        hessian[:, :2, :2] = np.where((corner & far)[:, None, None], curved, 0.0)
        return Evaluation(sign * length, gradient, hessian)


def _crosses(x: Array) -> bool:
    """Return whether edges of a closed polygon (m, 2) cross or overlap, or its area is zero."""
    a, b, m = x, np.roll(x, -1, axis=0), len(x)

    def side(p: Array, q: Array, r: Array) -> Array:
        return np.asarray(
            (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1])
            - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
        )

    first, second = np.triu_indices(m, 2)
    apart = ~((first == 0) & (second == m - 1))  # neighbours share a corner
    p, q, r, s = a[first[apart]], b[first[apart]], a[second[apart]], b[second[apart]]
    meets = (side(p, q, r) * side(p, q, s) <= 0) & (side(r, s, p) * side(r, s, q) <= 0)
    overlaps = (np.maximum(p, q) >= np.minimum(r, s)) & (np.maximum(r, s) >= np.minimum(p, q))
    return bool((meets & overlaps.all(axis=1)).any()) or not side(a, b, np.zeros_like(a)).sum()
