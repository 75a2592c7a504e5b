"""The local search for closer targets on the deformed surface (Smith et al. 2018, section 6)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from fem_snh.contact.reference.reference_surface import turned
from fem_snh.geometry.closest_points import closest_points

Array = npt.NDArray[Any]

#: Largest number of steps from a triangle to its neighbours.
_STEPS = 10
#: A step is taken if it makes the distance smaller by more than this fraction.
_CLOSER = 1e-6


class CloserTargets:
    """Triangles of a surface and their neighbours, along which targets are moved.

    Parameters
    ----------
    triangles : (m, 3) int
        The points of the triangles.
    """

    def __init__(self, triangles: Array) -> None:
        self._triangles = triangles
        m = len(triangles)
        ends = np.arange(0, 3 * m + 1, 3)
        points = csr_matrix((np.ones(3 * m, np.int16), triangles.ravel(), ends))
        common = csr_matrix(points @ points.T)
        counts = np.diff(common.indptr)
        rows = np.repeat(np.arange(m), counts)
        #: The triangles with a common point, itself among them, and itself again as padding.
        self._ring = np.repeat(np.arange(m)[:, None], counts.max(initial=1), axis=1)
        self._ring[rows, np.arange(len(rows)) - common.indptr[rows]] = common.indices

    def move(
        self, p: Array, normals: Array, sizes: Array, target: Array, x: Array, outward: Array
    ) -> tuple[Array, Array]:
        """Return triangles (n,) and barycentric coordinates (n, 3) of closer points.

        Parameters
        ----------
        p, normals : (n, 3)
            Positions of samples, and unit normals of the surface there.
        sizes : (n,)
            The size of the cells there [m].
        target : (n,) int
            The triangles from which the search starts.
        x : (points, 3)
            Positions of the surface's points.
        outward : (m, 3)
            Unit normals of the triangles.
        """
        target, coordinates = target.copy(), np.zeros((len(target), 3))
        best, left = np.full(len(p), np.inf), np.arange(len(p))
        for _ in range(_STEPS):
            near = self._ring[target[left]]
            found, arm = closest_points(p[left][:, None], x[self._triangles[near]])
            cosine = np.einsum("nki,ni->nk", outward[near], normals[left])
            length = turned(np.linalg.norm(arm, axis=2), cosine, sizes[left])
            row, least = np.arange(len(left)), length.argmin(axis=1)
            closer = length[row, least] < (1 - _CLOSER) * best[left]
            row, least, left = row[closer], least[closer], left[closer]
            best[left] = length[row, least]
            coordinates[left] = found[row, least]
            moved = near[row, least] != target[left]
            target[left] = near[row, least]
            left = left[moved]
            if not len(left):
                break
        return target, coordinates
