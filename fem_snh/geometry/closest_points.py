"""Closest points and normals of triangles, or of segments in two dimensions."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

Array = npt.NDArray[Any]

#: Barycentric coordinate below which a point is on an edge: closest points on edges have 0.
_ON_EDGE = 1e-9


def closest_points(p: Array, T: Array) -> tuple[Array, Array]:
    """Return the points of triangles, or of segments, that are closest to given points.

    Parameters
    ----------
    p : (n, 1, 3)
        The given points.
    T : (n, k, corners, 3)
        The corners of k triangles (3) or segments (2) for each point.

    Returns
    -------
    coordinates : (n, k, corners)
        Barycentric coordinates of the closest points.
    arm : (n, k, 3)
        The given point minus the closest point.
    """
    tiny, corners = np.finfo(float).tiny, T.shape[-2]
    best, arm = np.zeros(T.shape[:-1]), np.zeros(np.broadcast_shapes(p.shape, T[..., 0, :].shape))
    distance = np.full(arm.shape[:-1], np.inf)
    if corners == 3:
        a, ab, ac = T[..., 0, :], T[..., 1, :] - T[..., 0, :], T[..., 2, :] - T[..., 0, :]
        ap = p - a
        d11, d12, d22 = (np.einsum("nki,nki->nk", s, t) for s, t in ((ab, ab), (ab, ac), (ac, ac)))
        e1, e2 = (np.einsum("nki,nki->nk", s, ap) for s in (ab, ac))
        det = np.maximum(d11 * d22 - d12**2, tiny)
        v, w = (d22 * e1 - d12 * e2) / det, (d11 * e2 - d12 * e1) / det
        best = np.stack([1 - v - w, v, w], axis=2)
        arm = ap - v[..., None] * ab - w[..., None] * ac
        inside = (best >= 0).all(axis=2)
        distance = np.where(inside, np.einsum("nki,nki->nk", arm, arm), np.inf)
    for i, j in combinations(range(corners), 2):
        edge = T[..., j, :] - T[..., i, :]
        along = np.einsum("nki,nki->nk", p - T[..., i, :], edge)
        t = np.clip(along / np.maximum(np.einsum("nki,nki->nk", edge, edge), tiny), 0.0, 1.0)
        other = p - T[..., i, :] - t[..., None] * edge
        squared = np.einsum("nki,nki->nk", other, other)
        closer = squared < distance
        distance = np.where(closer, squared, distance)
        arm = np.where(closer[..., None], other, arm)
        coordinates = np.zeros_like(best)
        coordinates[..., i], coordinates[..., j] = 1 - t, t
        best = np.where(closer[..., None], coordinates, best)
    return best, arm


def triangle_normals(x: Array, triangles: Array) -> Array:
    """Return the unit normals (m, 3) of triangles (m, 3) int with points x (n, 3).

    They follow the right-hand rule. Segments (m, 2) with points (n, 2) have normals (m, 2) to the
    right of the direction from first to second point. Without area or length a normal is zero.
    """
    a, b, *others = (x[ends] for ends in triangles.T)
    if not others:
        return _unit((b - a)[:, ::-1] * (1.0, -1.0))
    return _unit(np.cross(b - a, others[0] - a))


class PseudoNormals:
    """Normals of a closed surface on its triangles, edges and corners.

    The normal of an edge is along the sum of its two triangles' normals, the normal of a corner
    along the sum of its triangles' normals weighted by their angles, so that the sign of the
    distance is right (Baerentzen & Aanaes 2005). On a curve, the normal of a point is along the sum
    of its two segments' normals.

    Parameters
    ----------
    triangles : (m, 3) int
        The points of each triangle; in two dimensions (m, 2), of each segment, and vectors have two
        components.
    """

    def __init__(self, triangles: Array) -> None:
        self._triangles = triangles
        flat = triangles.ravel()
        #: The corners of triangles, numbered triangle by triangle, at each point.
        self._at_point = csr_matrix(
            (np.ones(len(flat), bool), (flat, np.arange(len(flat)))),
            shape=(flat.max(initial=-1) + 1, len(flat)),
        )
        self._num_edges, self._edges = 0, np.empty((0, 3), int)
        if triangles.shape[1] == 2:
            return
        # Edge i of a triangle is opposite to its corner i.
        edges = np.stack([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]], axis=1)
        rows = np.sort(edges.reshape(-1, 2), axis=1)
        if len(rows):
            unique, index = np.unique(rows, axis=0, return_inverse=True)
            self._num_edges, self._edges = len(unique), index.reshape(-1, 3)

    def at(self, x: Array, chosen: Array, coordinates: Array) -> Array:
        """Return the unit normals at n points on the surface, (n, 3).

        Parameters
        ----------
        x : (points, 3)
            Positions of the triangles' points.
        chosen : (n,) int
            The triangle on which each point lies.
        coordinates : (n, 3)
            Barycentric coordinates in the triangle. With one zero the point is on an edge, with two
            at a corner.
        """
        normals = triangle_normals(x, self._triangles)
        found = normals[chosen]
        zeros = coordinates <= _ON_EDGE
        left = zeros.shape[1] - zeros.sum(axis=1)
        on = left == 2
        if self._num_edges and on.any():
            sums = _sum(self._edges.ravel(), np.repeat(normals, 3, axis=0), self._num_edges)
            found[on] = sums[self._edges[chosen[on], zeros[on].argmax(axis=1)]]
        on = left == 1
        if on.any():
            sums = _sum(self._triangles.ravel(), self._at_corners(x, normals), len(x))
            found[on] = sums[self._triangles[chosen[on], (~zeros[on]).argmax(axis=1)]]
        return _unit(found)

    def averaged(self, x: Array, chosen: Array, coordinates: Array, sharp: float) -> Array:
        """Return unit normals that vary continuously over a smooth part of the surface, (n, 3).

        They are interpolated between normals at the corners of the chosen triangle. A corner's
        normal is along the sum of the normals of the triangles there, weighted by their angles, if
        the cosine between their normal and the chosen triangle's is above ``sharp``. The other
        arguments are those of `at`.
        """
        normals, corners = triangle_normals(x, self._triangles), self._triangles.shape[1]
        weighted = self._at_corners(x, normals)
        found = np.zeros((len(chosen), normals.shape[1]))
        for corner in range(corners):
            at_point = self._at_point[self._triangles[chosen, corner]]
            rows = np.repeat(np.arange(len(chosen)), np.diff(at_point.indptr))
            around = at_point.indices
            cosine = np.einsum("ni,ni->n", normals[around // corners], normals[chosen][rows])
            rows, around = rows[cosine > sharp], around[cosine > sharp]
            found += coordinates[:, [corner]] * _unit(_sum(rows, weighted[around], len(chosen)))
        return _unit(found)

    def _at_corners(self, x: Array, normals: Array) -> Array:
        """Return each triangle's normal times its angle at each corner, (m * corners, dim)."""
        if self._triangles.shape[1] == 2:
            return np.repeat(normals, 2, axis=0)
        angles = _angles(x[self._triangles])
        return np.asarray((angles[..., None] * normals[:, None]).reshape(-1, 3))


def _unit(vectors: Array) -> Array:
    """Return the vectors (n, dim) scaled to length 1; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, np.finfo(float).tiny))


def _sum(index: Array, values: Array, size: int) -> Array:
    """Return the sums (size, dim) of the vectors (n, dim) that have the same index (n,)."""
    return np.stack([np.bincount(index, column, size) for column in values.T], axis=1)


def _angles(corners: Array) -> Array:
    """Return the angles (m, 3) [rad] at the corners (m, 3, 3) of triangles."""
    there = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    cross = np.linalg.norm(np.cross(there, back), axis=2)
    return np.asarray(np.arctan2(cross, np.einsum("mki,mki->mk", there, back)))
