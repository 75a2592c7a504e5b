"""The closest points of a surface in the reference configuration."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fem_snh.geometry.closest_points import PseudoNormals, closest_points

Array = npt.NDArray[Any]

#: How many of the closest triangles' midpoints are examined, more where these few do not prove
#: that no other triangle is closer; then all.
_EXAMINED = (24, 96, 384)
#: A triangle whose outward normal is that of the point counts as this much farther away than one of
#: the opposite normal, with a linear function of the cosine between: points near an edge of the
#: surface have the face that they have passed through as a target, not the one beside it.
_TURNED = 3.0
#: And as much as this part of a cell: a point on the edge itself has the same distance, zero, from
#: the face that it has passed through and from the one beside it.
_BESIDE = 0.5
#: Points times triangles that are examined at a time, which bounds the memory.
_BATCH = 200_000


def turned(length: Array, cosine: Array, size: Array) -> Array:
    """Return distances (n, k) of triangles from points, with preference for opposed ones.

    Parameters
    ----------
    length, cosine : (n, k)
        The distances [m]; the cosines of the triangles' normals with those of the points.
    size : (n,)
        The size of the cells at the points [m].
    """
    beside = (1 + cosine) / 2
    return np.asarray(length * (1 + (_TURNED - 1) * beside) + _BESIDE * size[:, None] * beside)


class Closest(NamedTuple):
    """The closest points of a surface to n given points.

    Attributes
    ----------
    triangle : (n,) int
        The triangle of each.
    coordinates : (n, 3)
        Barycentric coordinates in it.
    nearest : (n,) int
        The triangle that is nearest, opposed or not.
    depth : (n,)
        Distance of the given point from the surface [m], positive inside.
    """

    triangle: Array
    coordinates: Array
    nearest: Array
    depth: Array


class ReferenceSurface:
    """Triangles that do not move, and the closest ones of a body to points.

    Parameters
    ----------
    points : (n, 3)
        Positions [m].
    triangles : (m, 3) int
        Closed and outward for each body.
    bodies : (m,) int
        The body of each triangle; those of other bodies do not count for a point.
    """

    def __init__(self, points: Array, triangles: Array, bodies: Array) -> None:
        self._points, self._normals = points, PseudoNormals(triangles)
        self._corners = points[triangles]
        self._triangles = {body: np.flatnonzero(bodies == body) for body in np.unique(bodies)}
        middles = self._corners.mean(axis=1)
        self._trees = {body: cKDTree(middles[own]) for body, own in self._triangles.items()}
        arms = self._corners - middles[:, None]
        self._radius = np.linalg.norm(arms, axis=2).max(axis=1)

    def closest(
        self, X: Array, bodies: Array, normals: Array, sizes: Array, outward: Array
    ) -> Closest:
        """Return the closest points to reference positions, of faces that are opposed to them.

        Parameters
        ----------
        X : (n, 3)
            Reference positions [m].
        bodies : (n,) int
            Their bodies.
        normals : (n, 3)
            Unit normals of the points in the deformed configuration.
        sizes : (n,)
            The size of the cells there [m].
        outward : (triangles, 3)
            Those of the triangles.
        """
        nearest, target = (_Points.empty(len(X)) for _ in range(2))
        for body in np.unique(bodies):
            if body in self._triangles:
                left = np.flatnonzero(bodies == body)
                self._search(X, left, body, normals, sizes, outward, nearest, target)
        depth = np.full(len(X), -np.inf)  # a body without a surface
        known = np.isin(bodies, list(self._triangles))
        arms = nearest.arms[known]
        normals = self._normals.at(
            self._points, nearest.triangle[known], nearest.coordinates[known]
        )
        inside = np.einsum("ni,ni->n", arms, normals) <= 0
        depth[known] = np.linalg.norm(arms, axis=1) * np.where(inside, 1, -1)
        return Closest(target.triangle, target.coordinates, nearest.triangle, depth)

    def _search(
        self,
        X: Array,
        left: Array,
        body: int,
        normals: Array,
        sizes: Array,
        outward: Array,
        nearest: _Points,
        target: _Points,
    ) -> None:
        """Set the rows ``left`` of the last two arguments to those of a body's triangles."""
        own, tree = self._triangles[body], self._trees[body]
        radius = float(self._radius[own].max())
        for count in (*_EXAMINED, len(own)):
            count = min(count, len(own))
            unsure = [np.empty(0, int)]
            for which in np.array_split(left, max(1, count * len(left) // _BATCH)):
                distances, near = tree.query(X[which], np.arange(1, count + 1))
                near = own[near]
                found, arm = closest_points(X[which][:, None], self._corners[near])
                length = np.linalg.norm(arm, axis=2)
                cosine = np.einsum("nki,ni->nk", outward[near], normals[which])
                preferred = turned(length, cosine, sizes[which])
                for points, measure in ((nearest, length), (target, preferred)):
                    points.set(which, measure.argmin(axis=1), near, found, arm)
                sure = distances[:, -1] - radius >= length.min(axis=1)
                unsure.append(which[~sure])
            left = np.concatenate(unsure)
            if count == len(own) or not len(left):
                return


class _Points(NamedTuple):
    """Points of the surface: triangles, coordinates, and the arms from them to given points."""

    triangle: Array
    coordinates: Array
    arms: Array

    @classmethod
    def empty(cls, size: int) -> _Points:
        """Return points to be set."""
        return cls(np.zeros(size, int), np.zeros((size, 3)), np.zeros((size, 3)))

    def set(self, which: Array, best: Array, near: Array, found: Array, arm: Array) -> None:
        """Set rows to the best of the examined triangles."""
        row = np.arange(len(which))
        self.triangle[which] = near[row, best]
        self.coordinates[which], self.arms[which] = found[row, best], arm[row, best]
