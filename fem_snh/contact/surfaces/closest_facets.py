"""The facet of a deformed surface that is closest to a point."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fem_snh.contact.surfaces.gathered_surface import FacetShape, Side
from fem_snh.geometry.closest_points import closest_points

Array = npt.NDArray[Any]

#: How many of the closest triangles' midpoints are examined: more where these few do not prove that
#: no other triangle is closer. Contact is with one of the closest hundred triangles, or with none.
_EXAMINED = (12, 48, 192)
#: Points times triangles that are examined at a time, which bounds the memory.
_BATCH = 200_000
#: Distances in radii of triangles below which two are equal.
_EQUAL = 1e-6
#: Rounding of barycentric coordinates on edges and at nodes.
_ON_EDGE = 1e-9


class Closest(NamedTuple):
    """The closest facets of some points.

    Attributes
    ----------
    facet : (n,) int
        The facet that a point may touch; -1 if there is none.
    start : (n, 2)
        Approximate reference coordinates of the closest point on it.
    """

    facet: Array
    start: Array


class ClosestFacets:
    """A surface of triangles around the midpoint of each facet, and the search in it.

    Facets of degree 1 are searched as they are (a quadrilateral as four triangles), those of degree
    2 with their midside nodes (six or eight triangles). The facet that is found is used with its
    own shape functions.

    Parameters
    ----------
    shape : FacetShape
        The facets' shape functions.
    side : Side
        The facets.
    """

    def __init__(self, shape: FacetShape, side: Side) -> None:
        self._side, self._shape = side, shape
        self._center = shape.evaluate(shape.center[None], 0)[0][0]
        a, b = shape.outline, np.roll(shape.outline, -1)
        self._facet = np.repeat(np.arange(len(side)), len(a))
        self._corners = np.stack([side.nodes[:, a].ravel(), side.nodes[:, b].ravel()], axis=1)
        center = np.broadcast_to(shape.center, (len(a), 2))
        reference = np.stack([center, shape.nodes[a], shape.nodes[b]], axis=1)
        self._reference = np.tile(reference, (len(side), 1, 1))
        edges = np.sort(self._corners, axis=1)
        _, which, counts = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        rim = counts[which.ravel()] == 1
        # For each triangle, whether its edge and its two nodes are on the surface's own edge.
        nodes = np.isin(self._corners, self._corners[rim])
        self._on_rim = np.column_stack([rim, nodes])

    def find(self, x: Array, points: Array, normals: Array, reach: float) -> Closest:
        """Return the facets that points of another surface may touch.

        It is the closest facet within reach whose outward normal is opposed to the point's. There
        is none if the point has passed it without being inside of the body, by the sign of its
        distance from the surface, and if the point is beside the edge of the surface.

        Parameters
        ----------
        x : (m, 3)
            Positions of the nodes [m].
        points, normals : (n, 3)
            The points [m] and the outward normals of their own surface.
        reach : float
            Largest distance [m].
        """
        centers = np.einsum("k,fki->fi", self._center, x[self._side.nodes])
        T = np.concatenate([centers[self._facet][:, None], x[self._corners]], axis=1)
        normal = np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0])
        # The outline runs anticlockwise on the reference facet.
        normal *= self._side.outward[self._facet][:, None]
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal /= np.maximum(length, np.finfo(float).tiny)
        middle = T.mean(axis=1)
        radius = float(np.linalg.norm(T - middle[:, None], axis=2).max())
        tree = cKDTree(middle)

        facet, start = np.full(len(points), -1), np.zeros((len(points), 2))
        low, high = middle.min(axis=0) - radius - reach, middle.max(axis=0) + radius + reach
        left = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        for count in _EXAMINED:
            count = min(count, len(T))
            unsure = [np.empty(0, int)]
            batches = max(1, count * len(left) // _BATCH)
            for which in np.array_split(left, batches) if len(left) else ():
                distances, near = tree.query(points[which], np.arange(1, count + 1))
                found = _Examined(points[which], normals[which], T[near], normal[near], radius)
                touched = found.valid(self._on_rim[near], reach)
                row = np.arange(len(which))
                chosen = near[row, found.opposed]
                facet[which] = np.where(touched, self._facet[chosen], -1)
                start[which] = np.einsum(
                    "nb,nbi->ni", found.coordinates[row, found.opposed], self._reference[chosen]
                )
                needed = np.minimum(found.distance, reach)
                unsure.append(which[distances[:, -1] - radius < needed])
            left = np.concatenate(unsure)
            if count == len(T) or not len(left):
                break
        return Closest(facet, start)


class _Examined:
    """Points (n, 3) and the triangles (n, k, 3, 3) that are examined for each of them."""

    def __init__(self, p: Array, own: Array, T: Array, normal: Array, radius: float) -> None:
        self._equal = _EQUAL * radius
        self.coordinates, arm = closest_points(p[:, None], T)
        self._distances = np.linalg.norm(arm, axis=2)
        self._heights = np.einsum("nki,nki->nk", arm, normal)
        facing = np.einsum("nki,ni->nk", normal, own) < 0
        self._closest = self._select(self._distances)
        distances = np.where(facing, self._distances, np.inf)
        #: For each point, which triangle is the closest one that faces it, and its distance.
        self.opposed = self._select(distances)
        self.distance = np.take_along_axis(distances, self.opposed[:, None], axis=1)[:, 0]

    def _select(self, distances: Array) -> Array:
        """Return the closest triangle; of several the one that the point is most in front of."""
        smallest = distances.min(axis=1, keepdims=True)
        equal = distances <= smallest + self._equal
        return np.asarray(np.where(equal, np.abs(self._heights), -1.0).argmax(axis=1))

    def valid(self, on_rim: Array, reach: float) -> Array:
        """Return which points may touch their opposed triangle, (n,) bool."""
        row = np.arange(len(self.opposed))
        height = self._heights[row, self.opposed]
        inside = self._heights[row, self._closest] <= self._equal
        found = (self.distance <= reach) & ((height >= 0) | inside)
        # Barycentric coordinates: zero of the midpoint on the edge, one of a node at the node.
        coordinates, on_rim = self.coordinates[row, self.opposed], on_rim[row, self.opposed]
        at = np.column_stack([coordinates[:, :1] < _ON_EDGE, coordinates[:, 1:] > 1 - _ON_EDGE])
        aside = np.where(np.isfinite(self.distance), self.distance, 0.0) ** 2 - height**2
        beside = (on_rim & at).any(axis=1) & (aside > self._equal**2)
        return np.asarray(found & ~beside)
