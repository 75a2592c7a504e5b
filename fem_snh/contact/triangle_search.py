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
from scipy.spatial import cKDTree

from fem_snh.geometry.closest_points import closest_points

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
