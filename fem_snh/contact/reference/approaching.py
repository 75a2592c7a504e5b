"""Samples of a surface that approach another part of it from outside."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fem_snh.geometry.closest_points import closest_points

Array = npt.NDArray[Any]

#: Only triangles whose outward normal has at most this cosine with the sample's are approached: two
#: surfaces that touch have opposite normals, and flesh beside a crease has not.
_OPPOSED = -0.5
#: A sample is in front of a triangle, not beside its edge, if the way to its closest point has at
#: least this cosine with the triangle's normal.
_FRONT = 0.85
#: How many of the triangles that are closest in position and in opposite normal are examined.
_EXAMINED = 4


class Approaching(NamedTuple):
    """Samples and the closest points of the surface that is opposed to them.

    Attributes
    ----------
    sample, triangle : (n,) int
        A sample and a triangle.
    coordinates : (n, 3)
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
    chosen: Array,
    corners: Array,
    outward: Array,
    distance: float,
) -> Approaching:
    """Return those samples that are in front of an opposed triangle, closer than a distance.

    Parameters
    ----------
    points, normals : (samples, 3)
        Positions of samples and unit normals of the surface there.
    chosen : (n,) int
        The samples that are searched.
    corners, outward : (m, 3, 3), (m, 3)
        Positions of the corners of the surface's triangles [m], and their unit normals.
    distance : float
        The largest distance [m].
    """
    # The midpoint of a triangle is farther than its closest point, by its radius at most.
    middles = corners.mean(axis=1)
    radius = float(np.linalg.norm(corners - middles[:, None], axis=2).max(initial=0.0))
    # |n + n_t|^2 = 2 + 2 cos: in six dimensions opposed triangles nearby are the closest points.
    tree = cKDTree(np.column_stack([middles, distance * outward]))
    wanted = np.column_stack([points, -distance * normals])[chosen]
    bound = ((distance + radius) ** 2 + distance**2 * (2 + 2 * _OPPOSED)) ** 0.5
    count = min(_EXAMINED, len(corners))
    _, near = tree.query(wanted, np.arange(1, count + 1), distance_upper_bound=bound)
    found = np.flatnonzero(near[:, 0] < len(corners))
    near = np.where(near < len(corners), near, near[:, :1])[found]
    sample = chosen[found]
    coordinates, arm = closest_points(points[sample][:, None], corners[near])
    length = np.linalg.norm(arm, axis=2)
    cosine = np.einsum("nki,ni->nk", outward[near], normals[sample])
    front = np.einsum("nki,nki->nk", outward[near], arm) > _FRONT * length
    length = np.where(front & (cosine <= _OPPOSED), length, np.inf)
    best, row = length.argmin(axis=1), np.arange(len(sample))
    shortest = length[row, best]
    kept = shortest <= distance
    return Approaching(
        sample[kept], near[row, best][kept], coordinates[row, best][kept], shortest[kept]
    )
