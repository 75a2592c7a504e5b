"""Closest points and normals of triangles, or of segments in two dimensions: compiled loops."""

from __future__ import annotations

import functools
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from fem_snh.arrays import Array
from fem_snh.kernels import build
from fem_snh.kernels.build import cdata

#: Barycentric coordinate below which a point is on an edge: closest points on edges have 0.
_ON_EDGE = 1e-9
#: `turned` multiplies the distance of a triangle by this if its outward normal is the point's, by 1
#: if it is opposite, linearly in the cosine between: the target of a point near an edge of the
#: surface is then the face that it has passed through, not the face beside it.
_TURNED = 3.0
#: It adds so many cells in the same way: a point on the edge is at distance zero from both faces.
_BESIDE = 0.5
#: Largest number of steps from a triangle to its neighbours.
_STEPS = 10
#: A step is taken if it makes the distance smaller by more than this fraction.
_CLOSER = 1e-6


@functools.cache
def _library() -> Any:
    """Open the library, compiled unless the cache has it. Not collective."""
    values = {"TURNED": _TURNED, "BESIDE": _BESIDE, "STEPS": _STEPS, "CLOSER": _CLOSER}
    definitions = [f"#define {name} {value}" for name, value in values.items()]
    return build.open_library(["surface_search_api.h"], ["surface_search_kernels.h"], definitions)


class Candidates(NamedTuple):
    """The k triangles that are examined for each of n points.

    Attributes
    ----------
    triangle : (n, k) int
        The triangles.
    coordinates : (n, k, corners)
        Barycentric coordinates of the point of each triangle that is closest to the given point.
    arm : (n, k, 3)
        The given points minus these closest points [m].
    distance : (n, k)
        The lengths of the arms [m].
    cosine : (n, k)
        The cosines of the triangles' outward normals with the given points' normals.
    """

    triangle: Array
    coordinates: Array
    arm: Array
    distance: Array
    cosine: Array

    def choose(self, column: Array) -> Candidates:
        """Return the candidate in a column (n,) int for each point; arrays lose their axis k."""
        row = np.arange(len(column))
        return Candidates(*(values[row, column] for values in self))


class Targets(NamedTuple):
    """The closest of the triangles that are examined for each of n points, and the targets.

    Attributes
    ----------
    nearest : (n,) int
        The closest triangle.
    place : (n, corners)
        Barycentric coordinates of its closest point.
    arm : (n, dim)
        The given point minus this closest point [m].
    distance : (n,)
        The length of the arm [m].
    target : (n,) int
        The triangle with the least distance if distances increase unless its normal opposes the
        point's: by the factor 1 + 2 b, and by b/2 cells, with b half of 1 plus the cosine.
    coordinates : (n, corners)
        Barycentric coordinates of its closest point.
    """

    nearest: Array
    place: Array
    arm: Array
    distance: Array
    target: Array
    coordinates: Array


class Triangles:
    """Triangles, or segments, of which the closest to given points are searched.

    ``points`` (n, 3) are positions [m], ``normals`` (n, 3) unit normals of the surface that they
    are on, ``sizes`` (n,) the sizes of the cells there [m].

    Parameters
    ----------
    corners : (m, corners, 3)
        Their corners [m].
    outward : (m, 3)
        Their outward unit normals.
    """

    def __init__(self, corners: Array, outward: Array) -> None:
        ffi, self._lib = _library()
        self._c, self._d = corners.shape[1:]
        self._kept = cdata(corners), cdata(outward)
        self._surface = ffi.new("Surface *", (self._c, self._d, *self._kept))

    def examine(self, points: Array, normals: Array, triangle: Array) -> Candidates:
        """Return the candidates of given triangles (n, k) int of each point."""
        n, k = triangle.shape
        coordinates, arm = np.empty((n, k, self._c)), np.empty((n, k, self._d))
        distance, cosine = np.empty((2, n, k))
        self._lib.examine(
            self._surface, n, k, cdata(points), cdata(normals), cdata(triangle, np.int32),
            cdata(coordinates), cdata(arm), cdata(distance), cdata(cosine),
        )  # fmt: skip
        return Candidates(triangle, coordinates, arm, distance, cosine)

    def targets(self, points: Array, normals: Array, sizes: Array, triangle: Array) -> Targets:
        """Return the closest of given triangles (n, k) int of each point, and the targets."""
        n, k = triangle.shape
        nearest, target = np.empty((2, n), np.int32)
        place, coordinates = np.empty((2, n, self._c))
        arm, distance = np.empty((n, self._d)), np.empty(n)
        self._lib.closest_targets(
            self._surface, n, k, cdata(points), cdata(normals), cdata(sizes),
            cdata(triangle, np.int32), cdata(nearest, np.int32), cdata(place), cdata(arm),
            cdata(distance), cdata(target, np.int32), cdata(coordinates),
        )  # fmt: skip
        return Targets(nearest, place, arm, distance, target, coordinates)

    def walk(
        self, points: Array, normals: Array, sizes: Array, target: Array, ring: Array
    ) -> tuple[Array, Array]:
        """Return triangles (n,) and barycentric coordinates (n, corners) of closer targets.

        A target moves to a triangle of its ``ring`` (m, k) int while that is closer, by the
        distances of `Targets`.
        """
        target, coordinates = np.array(target, np.int32), np.zeros((len(points), self._c))
        self._lib.walk(
            self._surface, len(points), ring.shape[1], cdata(points), cdata(normals), cdata(sizes),
            cdata(ring, np.int32), cdata(target, np.int32), cdata(coordinates),
        )  # fmt: skip
        return target.astype(int), coordinates


def intersect(a: csr_matrix, rows: Array, b: csr_matrix, others: Array) -> Array:
    """Return whether row rows[i] of a and row others[i] of b have a common entry, (n,) bool.

    Both matrices have sorted indices, and no stored zeros.
    """
    found = np.empty(len(rows), np.uint8)
    patterns = [
        cdata(values, np.int32)
        for matrix, chosen in ((a, rows), (b, others))
        for values in (chosen, matrix.indptr, matrix.indices)
    ]
    ffi, lib = _library()
    lib.rows_intersect(len(rows), *patterns, build.pointer(ffi, found))
    return found.astype(bool)


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
        self.triangles = triangles
        flat = triangles.ravel()
        #: The corners of triangles, numbered triangle by triangle, at each point.
        self.at_point = csr_matrix(
            (np.ones(len(flat), bool), (flat, np.arange(len(flat)))),
            shape=(flat.max(initial=-1) + 1, len(flat)),
        )
        self.num_edges, self.edges = 0, np.empty((0, 3), int)
        if triangles.shape[1] == 2:
            return
        # Edge i of a triangle is opposite to its corner i.
        edges = np.stack([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]], axis=1)
        rows = np.sort(edges.reshape(-1, 2), axis=1)
        if len(rows):
            unique, index = np.unique(rows, axis=0, return_inverse=True)
            self.num_edges, self.edges = len(unique), index.reshape(-1, 3)

    def of(self, x: Array) -> Normals:
        """Return the normals for points at x (points, 3)."""
        return Normals(self, x)


class Normals:
    """The normals of `PseudoNormals` for one position of the surface's points.

    Parameters
    ----------
    surface : PseudoNormals
        The surface.
    x : (points, 3)
        Positions of the points [m].

    Attributes
    ----------
    outward : (m, 3)
        The unit normals of the triangles, by the right-hand rule; of segments to the right of the
        direction from first to second point. Without area or length a normal is zero.
    """

    def __init__(self, surface: PseudoNormals, x: Array) -> None:
        self._surface, self._num_points = surface, len(x)
        m, dim = surface.triangles.shape
        self.outward = np.empty((m, dim))
        #: Each triangle's normal times its angle at each corner; of segments times 1.
        self._weighted = np.empty((m * dim, dim))
        _library()[1].surface_normals(
            m,
            dim,
            cdata(surface.triangles, np.int32),
            cdata(x),
            cdata(self.outward),
            cdata(self._weighted),
        )

    @cached_property
    def _at_edges(self) -> Array:
        """The sums of both triangles' normals at each edge."""
        edges = self._surface.edges
        return _sum(edges.ravel(), np.repeat(self.outward, 3, axis=0), self._surface.num_edges)

    @cached_property
    def _at_points(self) -> Array:
        """The sums of the weighted normals at each point."""
        return _sum(self._surface.triangles.ravel(), self._weighted, self._num_points)

    def at(self, chosen: Array, coordinates: Array) -> Array:
        """Return the unit normals at n points on the surface, (n, 3).

        Parameters
        ----------
        chosen : (n,) int
            The triangle on which each point lies.
        coordinates : (n, 3)
            Barycentric coordinates in the triangle. With one zero the point is on an edge, with two
            at a corner.
        """
        found = self.outward[chosen]
        zeros = coordinates <= _ON_EDGE
        left = zeros.shape[1] - zeros.sum(axis=1)
        on = left == 2
        if self._surface.num_edges and on.any():
            found[on] = self._at_edges[self._surface.edges[chosen[on], zeros[on].argmax(axis=1)]]
        on = left == 1
        if on.any():
            corner = (~zeros[on]).argmax(axis=1)
            found[on] = self._at_points[self._surface.triangles[chosen[on], corner]]
        return _unit(found)

    def averaged(self, chosen: Array, coordinates: Array, sharp: float) -> Array:
        """Return unit normals that vary continuously over a smooth part of the surface, (n, 3).

        They are interpolated between normals at the corners of the chosen triangle. A corner's
        normal is along the sum of the normals of the triangles there, weighted by their angles, if
        the cosine between their normal and the chosen triangle's is above ``sharp``. The other
        arguments are those of `at`.
        """
        triangles, at_point = self._surface.triangles, self._surface.at_point
        found = np.empty((len(chosen), triangles.shape[1]))
        _library()[1].averaged_normals(
            len(chosen), triangles.shape[1], cdata(chosen, np.int32), cdata(coordinates),
            cdata(triangles, np.int32), cdata(self.outward), cdata(self._weighted),
            cdata(at_point.indptr, np.int32), cdata(at_point.indices, np.int32), sharp,
            cdata(found),
        )  # fmt: skip
        return found


def _unit(vectors: Array) -> Array:
    """Return the vectors (n, dim) scaled to length 1; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, np.finfo(float).tiny))


def _sum(index: Array, values: Array, size: int) -> Array:
    """Return the sums (size, dim) of the vectors (n, dim) that have the same index (n,)."""
    return np.stack([np.bincount(index, column, size) for column in values.T], axis=1)
