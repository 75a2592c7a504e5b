"""The search for the triangles of a surface that are closest to points.

All of contact searches here: the facets that a body may touch, targets in the reference
configuration, and parts of a surface that approach each other. They differ in what they choose of
the candidates. In two dimensions segments of a curve take the place of triangles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from fem_snh.geometry.closest_points import PseudoNormals, closest_points

Array = npt.NDArray[Any]

#: Points times triangles that are examined at a time, which bounds the memory.
_BATCH = 200_000


class Candidates(NamedTuple):
    """Triangles that are examined for each of n points, k for each.

    Attributes
    ----------
    triangle : (n, k) int
        The triangles.
    coordinates : (n, k, corners)
        Barycentric coordinates of their closest points.
    arm : (n, k, 3)
        The points minus these closest points [m].
    distance : (n, k)
        The lengths of the arms [m].
    cosine : (n, k)
        The cosines of the triangles' outward normals with those of the points.
    """

    triangle: Array
    coordinates: Array
    arm: Array
    distance: Array
    cosine: Array

    @classmethod
    def examine(
        cls, points: Array, normals: Array, triangle: Array, corners: Array, outward: Array
    ) -> Candidates:
        """Return given triangles of points.

        Parameters
        ----------
        points, normals : (n, 3)
            Positions [m] and unit normals.
        triangle : (n, k) int
            The triangles.
        corners, outward : (m, corners, 3), (m, 3)
            Corners [m] and outward unit normals of all triangles.
        """
        coordinates, arm = closest_points(points[:, None], corners[triangle])
        cosine = np.einsum("nki,ni->nk", outward[triangle], normals)
        return cls(triangle, coordinates, arm, np.linalg.norm(arm, axis=2), cosine)

    def choose(self, column: Array) -> Candidates:
        """Return one candidate of each point, (n,), by its column (n,) int."""
        row = np.arange(len(column))
        return Candidates(*(values[row, column] for values in self))


class TriangleTree:
    """Triangles or segments, found by their midpoints.

    Parameters
    ----------
    corners : (m, 3 or 2, 3)
        Corners [m].
    numbers : (k,) int, optional
        The triangles that are searched. Default: all.
    directions : (k, 3), optional
        Three more coordinates [m] of the midpoints: the tree has six dimensions.
    """

    def __init__(
        self, corners: Array, numbers: Array | None = None, directions: Array | None = None
    ) -> None:
        self._corners = corners
        self._numbers = np.arange(len(corners)) if numbers is None else numbers
        middles = corners[self._numbers].mean(axis=1)
        arms = np.linalg.norm(corners[self._numbers] - middles[:, None], axis=2)
        #: Lowest and highest coordinates of midpoints, and the largest distance of a corner.
        self.low, self.high = middles.min(axis=0), middles.max(axis=0)
        self.radius = float(arms.max(initial=0.0))
        both = middles if directions is None else np.column_stack([middles, directions])
        self._tree = cKDTree(both)

    def __len__(self) -> int:
        return len(self._numbers)

    def search(
        self,
        points: Array,
        normals: Array,
        outward: Array,
        rows: Array,
        counts: Sequence[int],
        receive: Callable[[Array, Candidates], Array],
        directions: Array | None = None,
        reach: float = np.inf,
    ) -> None:
        """Examine the closest triangles of points, more of them until no other can be closer.

        Parameters
        ----------
        points, normals : (n, 3)
            Positions [m] and unit normals.
        outward : (m, 3)
            Unit normals of the triangles.
        rows : (r,) int
            The points that are searched for.
        counts : sequence of int
            How many triangles are examined: the next number where the one before is too small.
        receive : callable
            Is called with some of the rows and their candidates, and returns the distance (n,) [m]
            beyond which triangles of these do not count.
        directions : (n, 3), optional
            The points' further coordinates, if the triangles have some.
        reach : float
            Largest distance of a midpoint, further coordinates included [m].
        """
        at = points if directions is None else np.column_stack([points, directions])
        for count in counts:
            count, unsure = min(count, len(self)), [np.empty(0, int)]
            for some in np.array_split(rows, max(1, count * len(rows) // _BATCH)):
                distances, near = self._tree.query(
                    at[some], np.arange(1, count + 1), distance_upper_bound=reach
                )
                known = near[:, 0] < len(self)
                some, near, distances = some[known], near[known], distances[known]
                near = self._numbers[np.where(near < len(self), near, near[:, :1])]
                found = Candidates.examine(
                    points[some], normals[some], near, self._corners, outward
                )
                unsure.append(some[distances[:, -1] - self.radius < receive(some, found)])
            rows = np.concatenate(unsure)
            if count == len(self) or not len(rows):
                return


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
#: Largest number of steps from a triangle to its neighbours.
_STEPS = 10
#: A step is taken if it makes the distance smaller by more than this fraction.
_CLOSER = 1e-6
#: Only triangles whose outward normal has at most this cosine with the sample's are approached: two
#: surfaces that touch have opposite normals, and flesh beside a crease has not.
_OPPOSED = -0.5
#: A sample is in front of a triangle, not beside its edge, if the way to its closest point has at
#: least this cosine with the triangle's normal.
_FRONT = 0.85
#: How many of the triangles that are closest in position and in opposite normal are examined.
_APPROACHED = 4


def turned(found: Candidates, sizes: Array) -> Array:
    """Return distances (n, k) of candidates [m], with preference for opposed ones.

    ``sizes`` (n,) are those of the cells at the points [m].
    """
    beside = (1 + found.cosine) / 2
    preferred = found.distance * (1 + (_TURNED - 1) * beside)
    return np.asarray(preferred + _BESIDE * sizes[:, None] * beside)


class ReferenceTargets(NamedTuple):
    """The closest points of a surface to n given points.

    Attributes
    ----------
    triangle : (n,) int
        The triangle of each.
    coordinates : (n, corners)
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
    points : (n, dim)
        Positions [m].
    triangles : (m, dim) int
        Closed and outward for each body; segments in two dimensions.
    bodies : (m,) int
        The body of each triangle; those of other bodies do not count for a point.
    """

    def __init__(self, points: Array, triangles: Array, bodies: Array) -> None:
        self._points, self._normals = points, PseudoNormals(triangles)
        corners = points[triangles]
        #: The triangles of each body.
        self._trees = {
            body: TriangleTree(corners, np.flatnonzero(bodies == body))
            for body in np.unique(bodies)
        }

    def closest(
        self, X: Array, bodies: Array, normals: Array, sizes: Array, outward: Array
    ) -> ReferenceTargets:
        """Return the closest points to reference positions, of faces that are opposed to them.

        Parameters
        ----------
        X : (n, dim)
            Reference positions [m].
        bodies : (n,) int
            Their bodies.
        normals : (n, dim)
            Unit normals of the points in the deformed configuration.
        sizes : (n,)
            The size of the cells there [m].
        outward : (triangles, dim)
            Those of the triangles.
        """
        nearest, target = np.zeros(len(X), int), np.zeros(len(X), int)
        place, nearest_place, arms = (np.zeros(X.shape) for _ in range(3))

        def receive(rows: Array, found: Candidates) -> Array:
            closest = found.choose(found.distance.argmin(axis=1))
            nearest[rows], nearest_place[rows] = closest.triangle, closest.coordinates
            arms[rows] = closest.arm
            preferred = found.choose(turned(found, sizes[rows]).argmin(axis=1))
            target[rows], place[rows] = preferred.triangle, preferred.coordinates
            return closest.distance

        for body, tree in self._trees.items():
            rows = np.flatnonzero(bodies == body)
            tree.search(X, normals, outward, rows, (*_EXAMINED, len(tree)), receive)
        depth = np.full(len(X), -np.inf)  # a body without a surface
        known = np.isin(bodies, list(self._trees))
        normal = self._normals.at(self._points, nearest[known], nearest_place[known])
        inside = np.einsum("ni,ni->n", arms[known], normal) <= 0
        depth[known] = np.linalg.norm(arms[known], axis=1) * np.where(inside, 1, -1)
        return ReferenceTargets(target, place, nearest, depth)


class CloserTargets:
    """Triangles of a surface and their neighbours, along which targets are moved.

    Parameters
    ----------
    triangles : (m, dim) int
        The points of the triangles, or of segments.
    """

    def __init__(self, triangles: Array) -> None:
        self._triangles = triangles
        m, corners = triangles.shape
        ends = np.arange(m + 1) * corners
        points = csr_matrix((np.ones(corners * m, np.int16), triangles.ravel(), ends))
        common = csr_matrix(points @ points.T)
        counts = np.diff(common.indptr)
        rows = np.repeat(np.arange(m), counts)
        #: The triangles with a common point, itself among them, and itself again as padding.
        self._ring = np.repeat(np.arange(m)[:, None], counts.max(initial=1), axis=1)
        self._ring[rows, np.arange(len(rows)) - common.indptr[rows]] = common.indices

    def move(
        self, p: Array, normals: Array, sizes: Array, target: Array, x: Array, outward: Array
    ) -> tuple[Array, Array]:
        """Return triangles (n,) and barycentric coordinates (n, corners) of closer points.

        Parameters
        ----------
        p, normals : (n, dim)
            Positions of samples, and unit normals of the surface there.
        sizes : (n,)
            The size of the cells there [m].
        target : (n,) int
            The triangles from which the search starts.
        x : (points, dim)
            Positions of the surface's points.
        outward : (m, dim)
            Unit normals of the triangles.
        """
        target, coordinates = target.copy(), np.zeros(p.shape)
        best, left = np.full(len(p), np.inf), np.arange(len(p))
        corners = x[self._triangles]
        for _ in range(_STEPS):
            ring = self._ring[target[left]]
            found = Candidates.examine(p[left], normals[left], ring, corners, outward)
            length = turned(found, sizes[left])
            row, least = np.arange(len(left)), length.argmin(axis=1)
            closer = length[row, least] < (1 - _CLOSER) * best[left]
            row, least, left = row[closer], least[closer], left[closer]
            best[left] = length[row, least]
            coordinates[left] = found.coordinates[row, least]
            moved = ring[row, least] != target[left]
            target[left] = ring[row, least]
            left = left[moved]
            if not len(left):
                break
        return target, coordinates


class Approaching(NamedTuple):
    """Samples and the closest points of the surface that is opposed to them.

    Attributes
    ----------
    sample, triangle : (n,) int
        A sample and a triangle.
    coordinates : (n, corners)
        Barycentric coordinates of the closest point in it.
    distance : (n,)
        The distance from it [m].
    """

    sample: Array
    triangle: Array
    coordinates: Array
    distance: Array


def approaching(
    points: Array,
    normals: Array,
    corners: Array,
    outward: Array,
    distance: float,
) -> Approaching:
    """Return those samples that are in front of an opposed triangle, closer than a distance.

    Parameters
    ----------
    points, normals : (samples, dim)
        Positions of samples and unit normals of the surface there.
    corners, outward : (m, corners, dim), (m, dim)
        Positions of the corners of the surface's triangles [m], and their unit normals.
    distance : float
        The largest distance [m].
    """
    tree = TriangleTree(corners, directions=distance * outward)
    # The midpoint of a triangle is farther than its closest point, by its radius at most, and
    # |n + N|^2 = 2 + 2 cos: opposed triangles nearby are the closest points, with the normals as
    # further coordinates.
    reach = ((distance + tree.radius) ** 2 + distance**2 * (2 + 2 * _OPPOSED)) ** 0.5
    parts = list[Approaching]()

    def receive(rows: Array, found: Candidates) -> Array:
        heights = np.einsum("nki,nki->nk", outward[found.triangle], found.arm)
        front = (heights > _FRONT * found.distance) & (found.cosine <= _OPPOSED)
        length = np.where(front, found.distance, np.inf)
        best = found.choose(length.argmin(axis=1))
        shortest = length.min(axis=1)
        close = shortest <= distance
        columns = rows, best.triangle, best.coordinates, shortest
        parts.append(Approaching(*(column[close] for column in columns)))
        return shortest

    every = np.arange(len(points))
    tree.search(points, normals, outward, every, [_APPROACHED], receive, -distance * normals, reach)
    return Approaching(*map(np.concatenate, zip(*parts, strict=True)))
