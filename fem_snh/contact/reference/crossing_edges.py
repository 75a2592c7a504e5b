"""Sharp edges of a surface that cross each other: no sample of either is in the other body."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Array = npt.NDArray[Any]

#: Edges whose two triangles have normals with a larger cosine are not sharp: where they cross, a
#: point is deeper by at most tan(10 degrees) times half an edge than the samples on the edges.
_SHARP = np.cos(np.radians(20.0))
#: Edges that meet at a smaller angle are parallel, and touch along their length.
_PARALLEL = np.sin(np.radians(1.0))
#: Greatest depth of a crossing in the smallest height of the edges' triangles. A wedge is solid
#: behind its edge as far as its faces extend, and the opposite edge of a body of one cell is there.
_DEPTH = 0.5


class Crossings(NamedTuple):
    """Pairs of edges that cross, or may in the next solve.

    Attributes
    ----------
    first, second : (n,) int
        The edges.
    place : (n, 2)
        Where they are closest: the position along each, from 0 to 1.
    normal : (n, 3)
        Outward unit normal of the second edge's body at the contact.
    facing : (n,)
        The smallest cosine of the normal, or its opposite, with the conormals of the edges' faces:
        0 where the normal is that of a face, as between two blocks whose faces lie on each other.
    """

    first: Array
    second: Array
    place: Array
    normal: Array
    facing: Array


class SurfaceEdges:
    """The edges of a closed surface.

    Parameters
    ----------
    triangles : (m, 3) int
        The points of its triangles.

    Attributes
    ----------
    points : (n, 2) int
        The ends of each edge.
    triangles, opposite : (n, 2) int
        Its two triangles, and the corner of each that is not on the edge.
    """

    def __init__(self, triangles: Array) -> None:
        ends = np.sort(triangles[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
        order = np.lexsort((ends[:, 1], ends[:, 0]))
        ends = ends[order]
        begins = np.ones(len(ends) + 1, bool)
        begins[1:-1] = (ends[1:] != ends[:-1]).any(axis=1)
        first = np.flatnonzero(begins)
        # Two bodies may touch along an edge in the mesh: four triangles, which no normal orders.
        first = first[:-1][np.diff(first) == 2]
        both = order[first[:, None] + [0, 1]]
        self.points, self.triangles = ends[first], both // 3
        self.opposite = triangles.reshape(-1)[both]

    def __len__(self) -> int:
        return len(self.points)

    def crossings(
        self, x: Array, outward: Array, distance: float, share: tuple[int, int]
    ) -> Crossings:
        """Return the pairs of sharp convex edges that touch, or are closer than a distance.

        The direction from one body to the other is normal to both edges. It must be between the
        normals of the faces at one edge, and its opposite between those at the other one: two
        wedges touch at their edges then, and at their faces otherwise.

        Parameters
        ----------
        x : (points, 3)
            Positions of the surface's points.
        outward : (triangles, 3)
            Unit normals of the triangles.
        distance : float
            Largest distance of edges [m].
        share : (int, int)
            Which part of the edges is searched, of how many.
        """
        a, b = x[self.points[:, 0]], x[self.points[:, 1]]
        normals = outward[self.triangles]
        behind = np.einsum("ni,ni->n", normals[:, 0], x[self.opposite[:, 1]] - a)
        cosine = np.einsum("ni,ni->n", normals[:, 0], normals[:, 1])
        sharp = np.flatnonzero((cosine < _SHARP) & (behind < 0))
        middle, along = (a + b)[sharp] / 2, (b - a)[sharp]
        length = np.linalg.norm(along, axis=1)
        i, j = _close(middle, length, distance, share)
        point, slope, sine = _closest(a[sharp], along, i, j)
        inside = ((point >= 0) & (point <= 1)).all(axis=1) & (sine > _PARALLEL)
        i, j, point, slope = i[inside], j[inside], point[inside], slope[inside]
        conormals, heights = self._conormals(x, sharp, along, normals[sharp])
        cosines = [np.einsum("nki,ni->nk", conormals[e], slope) for e in (i, j)]
        ways = np.stack([np.minimum(-s * cosines[0], s * cosines[1]).min(axis=1) for s in (1, -1)])
        normal = slope * np.where(ways[0] >= ways[1], 1.0, -1.0)[:, None]
        facing = ways.max(axis=0)
        apart = a[sharp][i] - a[sharp][j]
        apart += point[:, :1] * along[i] - point[:, 1:] * along[j]
        gap = np.einsum("ni,ni->n", normal, apart)
        depth = _DEPTH * np.minimum(heights[i], heights[j])
        kept = (facing > 0) & (gap <= distance) & (gap >= -depth)
        return Crossings(sharp[i[kept]], sharp[j[kept]], point[kept], normal[kept], facing[kept])

    def _conormals(
        self, x: Array, chosen: Array, along: Array, normals: Array
    ) -> tuple[Array, Array]:
        """Return the conormals of edges in both triangles (n, 2, 3), and the smaller height (n,).

        A conormal is a unit vector in a triangle, normal to its edge and outward; the height [m] is
        that of the triangle over the edge.
        """
        across = np.cross(along[:, None], normals)
        across /= np.maximum(np.linalg.norm(across, axis=2, keepdims=True), np.finfo(float).tiny)
        inward = x[self.opposite[chosen]] - x[self.points[chosen, 0]][:, None]
        height = np.einsum("nki,nki->nk", across, inward)
        return -np.sign(height)[..., None] * across, np.abs(height).min(axis=1)


def _close(
    middle: Array, length: Array, distance: float, share: tuple[int, int]
) -> tuple[Array, Array]:
    """Return edges i < j (n,) whose closest points may be within a distance."""
    count, (rank, ranks) = len(middle), share
    own = np.arange(count * rank // ranks, count * (rank + 1) // ranks)
    none = np.empty(0, int)
    if not len(own):
        return none, none
    reach = length[own] / 2 + length.max() / 2 + distance
    found = cKDTree(middle).query_ball_point(middle[own], reach, return_sorted=True)
    i = np.repeat(own, [len(js) for js in found])
    j = np.concatenate([none, *(js for js in found if js)]).astype(int)
    near = np.linalg.norm(middle[i] - middle[j], axis=1) <= (length[i] + length[j]) / 2 + distance
    kept = near & (i < j)
    return i[kept], j[kept]


def _closest(start: Array, along: Array, i: Array, j: Array) -> tuple[Array, Array, Array]:
    """Return where the lines of edges are closest, (n, 2), their normal, and their angle's sine."""
    d, e, apart = along[i], along[j], start[i] - start[j]
    dd, ee, de = (np.einsum("ni,ni->n", p, q) for p, q in ((d, d), (e, e), (d, e)))
    d_apart, e_apart = (np.einsum("ni,ni->n", p, apart) for p in (d, e))
    tiny = np.finfo(float).tiny
    determinant = np.maximum(dd * ee - de**2, tiny)
    point = np.stack([de * e_apart - ee * d_apart, dd * e_apart - de * d_apart], axis=1)
    normal = np.cross(d, e)
    size = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(size, tiny)[:, None]
    return point / determinant[:, None], normal, size / np.maximum(np.sqrt(dd * ee), tiny)
