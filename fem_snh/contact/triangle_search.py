r"""The search for the triangles of a surface that are closest to points, and gaps to facets.

`ClosestFacets` finds the facets that another body may touch, `ReferenceSurface` targets in the
reference configuration, `approaching` parts of a surface that approach each other. In two
dimensions segments of a curve take the place of triangles.

Contact of two surfaces assigns one facet of the other surface to each point x, constant during a
solve. With the facet's nodes at :math:`y_b`, the closest point is
:math:`y(\xi) = \sum_b N_b(\xi) y_b`, where :math:`(x - y) \cdot y_{,\alpha} = 0`. With the outward
unit normal n of the facet there, the gap is :math:`g = n \cdot (x - y)`, positive outside the body
of the facet. With the metric :math:`m_{\alpha\beta} = y_{,\alpha} \cdot y_{,\beta}`, the curvature
:math:`b_{\alpha\beta} = n \cdot y_{,\alpha\beta}`, and the variations

.. math:: s_\alpha = n \cdot \delta y_{,\alpha}, \qquad
    t_\alpha = y_{,\alpha} \cdot (\delta x - \delta y), \qquad
    \delta\xi = (m - g\, b)^{-1} (t + g\, s)

at fixed :math:`\xi`, the derivatives of the gap are (Wriggers 2006, section 4.2)

.. math::

    \delta g &= n \cdot (\delta x - \delta y), \\
    \delta^2 g &= g\, (s + b\, \delta\xi)^T m^{-1} (s + b\, \delta\xi) - 2\, s^T \delta\xi
        - \delta\xi^T b\, \delta\xi .
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from fem_snh.arrays import Array
from fem_snh.assembly.cell_search import points_in_boxes
from fem_snh.contact.closest_points import PseudoNormals, Triangles
from fem_snh.contact.gathered_surface import FacetShape, Side
from fem_snh.contact.surface_quadrature import cross_tangents

#: Points times triangles that are examined at a time, which bounds the memory.
_BATCH = 200_000


class TriangleTree:
    """A k-d tree of the midpoints of triangles or segments.

    Parameters
    ----------
    corners : (m, 3 or 2, 3)
        Corners [m].
    numbers : (k,) int, optional
        The triangles in the tree. Default: all.
    """

    def __init__(self, corners: Array, numbers: Array | None = None) -> None:
        self._numbers = np.arange(len(corners)) if numbers is None else numbers
        middles = corners[self._numbers].mean(axis=1)
        arms = np.linalg.norm(corners[self._numbers] - middles[:, None], axis=2)
        #: Box of the midpoints, and the largest distance of a corner from its midpoint [m].
        self.low, self.high = middles.min(axis=0), middles.max(axis=0)
        self.radius = float(arms.max(initial=0.0))
        self._tree = cKDTree(middles)

    def __len__(self) -> int:
        return len(self._numbers)

    def search(
        self,
        points: Array,
        rows: Array,
        counts: Sequence[int],
        receive: Callable[[Array, Array], Array],
    ) -> None:
        """Pass the triangles that are closest to points to ``receive``.

        Parameters
        ----------
        points : (n, 3)
            Positions [m].
        rows : (r,) int
            The points to search for.
        counts : sequence of int
            How many triangles to examine for each point. Points for which another triangle may
            count are searched again with the next number.
        receive : callable
            Is called with some of the rows, (s,), and triangles for each, (s, k); returns the
            distances (s,) [m] beyond which a triangle does not count. A later call for a row
            replaces an earlier one.
        """
        for count in counts:
            count, unsure = min(count, len(self)), [np.empty(0, int)]
            for some in np.array_split(rows, max(1, count * len(rows) // _BATCH)):
                distances, near = self._tree.query(points[some], np.arange(1, count + 1))
                farthest = receive(some, self._numbers[near])
                unsure.append(some[distances[:, -1] - self.radius < farthest])
            rows = np.concatenate(unsure)
            if count == len(self) or not len(rows):
                return


#: How many triangles are examined for a point, by the distance of their midpoints: the next number
#: if these do not prove that no other triangle is closer; then all.
_EXAMINED = (24, 96, 384)
#: A triangle is opposed to a sample if their outward normals have at most this cosine: surfaces
#: that touch have opposite normals, the two sides of a crease have not.
_OPPOSED = -0.5
#: A sample is in front of a triangle, not beside its edge, if the vector from its closest point to
#: the sample has more than this cosine with the triangle's normal.
_FRONT = 0.85


class ReferenceTargets(NamedTuple):
    """The targets of n points on a surface in the reference configuration.

    Attributes
    ----------
    triangle : (n,) int
        The triangle with the target: see `fem_snh.contact.closest_points.Targets`.
    coordinates : (n, corners)
        Barycentric coordinates of the target in this triangle.
    nearest : (n,) int
        The closest triangle.
    depth : (n,)
        Distance of the point from the surface [m], positive inside; -inf if the point's body has
        no triangle.
    """

    triangle: Array
    coordinates: Array
    nearest: Array
    depth: Array


class ReferenceSurface:
    """The surfaces of bodies in the reference configuration, where targets are searched.

    Parameters
    ----------
    points : (n, dim)
        Reference positions of the surfaces' points [m].
    triangles : (m, dim) int
        The points of each triangle, or segment: closed surfaces with outward normals.
    bodies : (m,) int
        The body of each triangle: a point's target is on the surface of its body.
    """

    def __init__(self, points: Array, triangles: Array, bodies: Array) -> None:
        self._normals = PseudoNormals(triangles).of(points)
        self._corners = corners = points[triangles]
        #: The triangles of each body.
        self._trees = {
            body: TriangleTree(corners, np.flatnonzero(bodies == body))
            for body in np.unique(bodies)
        }

    def closest(
        self, X: Array, bodies: Array, normals: Array, sizes: Array, outward: Array
    ) -> ReferenceTargets:
        """Return the targets of reference positions.

        Parameters
        ----------
        X : (n, dim)
            Reference positions [m].
        bodies : (n,) int
            The bodies that contain them.
        normals : (n, dim)
            Unit normals of the samples, deformed, that are mapped to these positions.
        sizes : (n,)
            The sizes of the cells at the samples [m].
        outward : (m, dim)
            Outward unit normals of the triangles in the deformed configuration.
        """
        nearest, target = np.zeros(len(X), int), np.zeros(len(X), int)
        place, nearest_place, arms = (np.zeros(X.shape) for _ in range(3))

        triangles = Triangles(self._corners, outward)

        def receive(rows: Array, near: Array) -> Array:
            found = triangles.targets(X[rows], normals[rows], sizes[rows], near)
            nearest[rows], nearest_place[rows], arms[rows] = found[:3]
            target[rows], place[rows] = found.target, found.coordinates
            return found.distance

        for body, tree in self._trees.items():
            tree.search(X, np.flatnonzero(bodies == body), (*_EXAMINED, len(tree)), receive)
        depth = np.full(len(X), -np.inf)  # a body without a surface
        known = np.isin(bodies, list(self._trees))
        normal = self._normals.at(nearest[known], nearest_place[known])
        inside = np.einsum("ni,ni->n", arms[known], normal) <= 0
        depth[known] = np.linalg.norm(arms[known], axis=1) * np.where(inside, 1, -1)
        return ReferenceTargets(target, place, nearest, depth)


class CloserTargets:
    """A local search on the deformed surface, from triangle to neighbouring triangle.

    Parameters
    ----------
    triangles : (m, dim) int
        The points of each triangle, or of each segment.
    """

    def __init__(self, triangles: Array) -> None:
        self._triangles = triangles
        m, corners = triangles.shape
        ends = np.arange(m + 1) * corners
        points = csr_matrix((np.ones(corners * m, np.int16), triangles.ravel(), ends))
        common = csr_matrix(points @ points.T)
        counts = np.diff(common.indptr)
        rows = np.repeat(np.arange(m), counts)
        #: For each triangle: the triangles that share a point with it, itself included; padded by
        #: itself.
        self._ring = np.repeat(np.arange(m)[:, None], counts.max(initial=1), axis=1)
        self._ring[rows, np.arange(len(rows)) - common.indptr[rows]] = common.indices

    def move(
        self, p: Array, normals: Array, sizes: Array, target: Array, x: Array, outward: Array
    ) -> tuple[Array, Array]:
        """Return triangles (n,) and barycentric coordinates (n, corners) of closer points.

        See `Triangles.walk`.

        Parameters
        ----------
        p, normals : (n, dim)
            Positions of samples [m], and unit normals of the surface there.
        sizes : (n,)
            The sizes of the cells at the samples [m].
        target : (n,) int
            The triangles from which the search starts.
        x : (points, dim)
            Positions of the surface's points [m].
        outward : (m, dim)
            Outward unit normals of the triangles.
        """
        triangles = Triangles(x[self._triangles], outward)
        return triangles.walk(p, normals, sizes, target, self._ring)


class Approaching(NamedTuple):
    """Samples in front of a triangle with an opposed normal: n pairs.

    Attributes
    ----------
    sample, triangle : (n,) int
        The sample and the triangle of each pair.
    coordinates : (n, corners)
        Barycentric coordinates of the triangle's closest point.
    distance : (n,)
        The sample's distance from this point [m].
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
    """Return the samples that are close to an opposed triangle and in front of it.

    Each sample occurs at most once, with the closest such triangle.

    Parameters
    ----------
    points, normals : (samples, dim)
        Positions of samples [m] and unit normals of the surface there.
    corners, outward : (m, corners, dim), (m, dim)
        Corners of the surface's triangles [m], and the triangles' outward unit normals.
    distance : float
        The largest distance of a sample from its triangle [m].
    """
    # A sample in front of a triangle is in the prism above it, and beside this by a margin at most.
    prisms = np.concatenate([corners, corners + distance * outward[:, None]], axis=1)
    margin = distance * (1 - _FRONT**2) ** 0.5
    low, high = prisms.min(axis=1) - margin, prisms.max(axis=1) + margin
    sample, triangle = points_in_boxes(points, low, high)
    opposed = np.einsum("ni,ni->n", normals[sample], outward[triangle]) <= _OPPOSED
    sample, triangle = sample[opposed], triangle[opposed]
    every = Triangles(corners, outward).examine(points[sample], normals[sample], triangle[:, None])
    found = every.choose(np.zeros(len(sample), int))
    height = np.einsum("ni,ni->n", outward[triangle], found.arm)
    close = np.flatnonzero((height > _FRONT * found.distance) & (found.distance <= distance))
    ascending = close[np.lexsort((found.distance[close], sample[close]))]
    first = ascending[np.diff(sample[ascending], prepend=-1) > 0]
    return Approaching(
        sample[first], triangle[first], found.coordinates[first], found.distance[first]
    )


#: As `_EXAMINED`, but without all triangles at last: contact is with one of the closest hundred
#: triangles, or with none.
_FACETS_EXAMINED = (12, 48, 192)
#: Difference in radii of triangles below which two distances are equal.
_EQUAL = 1e-6
#: Rounding of barycentric coordinates on edges and at nodes.
_ON_EDGE = 1e-9
#: Newton's method for the closest point ends when reference coordinates change by less than this.
_CONVERGED = 1e-13
#: Its most iterations. It takes 1 on flat triangles, about 4 on curved facets.
_MAX_IT = 20
#: Added to the metric, relative to its trace, as a folded facet makes it singular.
_SINGULAR = 1e-14
#: A closest point farther outside the reference facet is no contact.
_OUTSIDE = 1.0


class FacetsInReach(NamedTuple):
    """The facets that n points may touch.

    Attributes
    ----------
    facet : (n,) int
        The facet that a point may touch; -1 if it may touch none.
    start : (n, d)
        Approximate reference coordinates of the closest point on this facet.
    """

    facet: Array
    start: Array


class ClosestFacets:
    """The search for the facets of one surface that points of another surface may touch.

    Each facet is searched as triangles between its midpoint and the nodes around it: three or four
    at degree 1, six or eight at degree 2; a curve as two segments. Gaps use the facet's own shape
    functions. (With two triangles a warped quadrilateral leans to one side: two plates that collide
    took up to six times the iterations.)

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
        count, d = shape.rim.shape
        self._facet = np.repeat(np.arange(len(side)), count)
        self._corners = side.nodes[:, shape.rim].reshape(-1, d)
        self._sense = np.tile(shape.sense, len(side))
        center = np.broadcast_to(shape.center, (count, 1, d))
        reference = np.concatenate([center, shape.nodes[shape.rim]], axis=1)
        self._reference = np.tile(reference, (len(side), 1, 1))
        edges = np.sort(self._corners, axis=1)
        _, which, counts = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        rim = counts[which.ravel()] == 1
        # For each triangle, whether its edge and its two nodes are on the surface's own edge; of a
        # segment, whether its node is an end of the curve.
        nodes = np.isin(self._corners, self._corners[rim])
        self._on_rim = np.column_stack([rim, nodes])

    def find(self, x: Array, points: Array, normals: Array, reach: float) -> FacetsInReach:
        """Return the facets that points of another surface may touch.

        A point's facet is the closest one whose outward normal has a negative product with the
        point's. The point has none if this facet is out of reach, if the point is behind the facet
        but outside the body, or if it is beside the edge of the surface.

        Parameters
        ----------
        x : (m, 3)
            Positions of the nodes [m].
        points, normals : (n, 3)
            The points [m] and the outward unit normals of their own surface.
        reach : float
            Largest distance of a point from its facet [m].
        """
        centers = np.einsum("k,fki->fi", self._center, x[self._side.nodes])
        T = np.concatenate([centers[self._facet][:, None], x[self._corners]], axis=1)
        normal = cross_tangents(np.swapaxes(T[:, 1:] - T[:, :1], 1, 2))
        normal *= (self._sense * self._side.outward[self._facet])[:, None]
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal /= np.maximum(length, np.finfo(float).tiny)
        tree, triangles = TriangleTree(T), Triangles(T, normal)
        equal = _EQUAL * tree.radius
        facet, start = np.full(len(points), -1), np.zeros((len(points), len(self._shape.center)))

        def receive(rows: Array, near: Array) -> Array:
            found = triangles.examine(points[rows], normals[rows], near)
            heights = np.einsum("nki,nki->nk", found.arm, normal[found.triangle])

            def closest(distances: Array) -> Array:
                """Return the closest triangle's column; of equals, the one of largest height."""
                smallest = distances.min(axis=1, keepdims=True)
                near = distances <= smallest + equal
                return np.asarray(np.where(near, np.abs(heights), -1.0).argmax(axis=1))

            row, facing = np.arange(len(rows)), np.where(found.cosine < 0, found.distance, np.inf)
            column = closest(facing)
            distance, height = facing[row, column], heights[row, column]
            chosen = found.choose(column)
            inside = heights[row, closest(found.distance)] <= equal
            # On the outer edge the midpoint's barycentric coordinate is 0; at a node its own is 1.
            xi = chosen.coordinates
            on_edge = np.column_stack([xi[:, :1] < _ON_EDGE, xi[:, 1:] > 1 - _ON_EDGE])
            aside = np.where(np.isfinite(distance), distance, 0.0) ** 2 - height**2
            beside = (self._on_rim[chosen.triangle] & on_edge).any(axis=1) & (aside > equal**2)
            touches = (distance <= reach) & ((height >= 0) | inside) & ~beside
            facet[rows] = np.where(touches, self._facet[chosen.triangle], -1)
            start[rows] = np.einsum("nb,nbi->ni", xi, self._reference[chosen.triangle])
            return np.minimum(distance, reach)

        low, high = tree.low - tree.radius - reach, tree.high + tree.radius + reach
        close = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        tree.search(points, close, _FACETS_EXAMINED, receive)
        return FacetsInReach(facet, start)


class Gaps(NamedTuple):
    r"""The gaps of n points to one facet each, and the quantities of the gaps' derivatives.

    Attributes
    ----------
    gap : (n,)
        The gap :math:`g = n \cdot (x - y)` [m], positive outside the facet's body; inf if the
        closest point is more than 1 outside the reference facet, or the facet has no normal there.
    normal : (n, 3)
        The outward unit normal n of the facet at the closest point.
    values : (n, k)
        Shape functions N_b of the facet at the closest point.
    derivatives : (n, k, d)
        Derivatives of the shape functions by the reference coordinates.
    tangents : (n, 3, d)
        The tangents :math:`y_{,\alpha}` [m].
    curvature : (n, d, d)
        The coefficients :math:`b_{\alpha\beta}` [m].
    outside : (n,)
        How far the closest point is outside the reference facet; <= 0 inside.
    """

    gap: Array
    normal: Array
    values: Array
    derivatives: Array
    tangents: Array
    curvature: Array
    outside: Array


def measure_gaps(
    shape: FacetShape, side: Side, x: Array, points: Array, facets: Array, start: Array
) -> Gaps:
    """Return the gap of each point to one given facet: see `Gaps` for sign and special values.

    Parameters
    ----------
    shape : FacetShape
        The shape functions of a facet.
    side : Side
        The facets.
    x : (m, 3)
        Positions of the nodes [m].
    points : (n, 3)
        Points of another surface [m].
    facets : (n,) int
        The facet of each point; -1 is not allowed.
    start : (n, d)
        Reference coordinates of a first guess of the closest point.
    """
    y, xi = x[side.nodes[facets]], np.array(start)
    left = np.arange(len(points))
    for _ in range(_MAX_IT):
        values, derivatives, second = shape.evaluate(xi[left], 2)
        arm = points[left] - np.einsum("nk,nki->ni", values, y[left])
        tangents = np.einsum("nki,nka->nia", y[left], derivatives)
        metric = np.einsum("nia,nib->nab", tangents, tangents)
        curved = metric - np.einsum("ni,nki,nkab->nab", arm, y[left], second, optimize=True)
        # Far from a curved facet the second derivative is indefinite; the metric then replaces it.
        definite = curved[:, 0, 0] > 0
        if curved.shape[1] == 2:
            minor = curved[:, 0, 0] * curved[:, 1, 1] - curved[:, 0, 1] ** 2
            definite &= minor > 0
        least = _SINGULAR * np.trace(metric, axis1=1, axis2=2) + np.finfo(float).tiny
        regular = metric + least[:, None, None] * np.eye(metric.shape[1])
        matrix = np.where(definite[:, None, None], curved, regular)
        slope = np.einsum("ni,nia->na", arm, tangents)
        step = np.linalg.solve(matrix, slope[..., None])[..., 0]
        moved = np.clip(xi[left] + step, -1 - _OUTSIDE, 2 + _OUTSIDE)
        change = np.abs(moved - xi[left]).max(axis=1, initial=0.0)
        xi[left] = moved
        left = left[change > _CONVERGED]
        if not len(left):
            break
    values, derivatives, second = shape.evaluate(xi, 2)
    tangents = np.einsum("nki,nka->nia", y, derivatives)
    normal = cross_tangents(tangents) * side.outward[facets, None]
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    np.divide(normal, size, out=normal, where=size > 0)
    gap = np.einsum("ni,ni->n", normal, points - np.einsum("nk,nki->ni", values, y))
    outside = shape.outside(xi)
    gap[(outside > _OUTSIDE) | (size[:, 0] == 0)] = np.inf  # a folded facet has no normal there
    curvature = np.einsum("ni,nki,nkab->nab", normal, y, second, optimize=True)
    return Gaps(gap, normal, values, derivatives, tangents, curvature, outside)


def gap_derivative(at: Gaps, basis: Array) -> Array:
    """Return the derivatives of n gaps by positions of nodes, (n, j + k, 3).

    ``basis`` (n, j) are the shape functions of each point's own facet. Its j nodes come first, then
    the k nodes of the other facet.
    """
    weights = np.concatenate([basis, -at.values], axis=1)
    return np.asarray(weights[:, :, None] * at.normal[:, None])


def gap_second_derivative(at: Gaps, basis: Array) -> tuple[Array, Array]:
    """Return the second derivatives of n gaps as products Q C Q^T.

    Returns
    -------
    Q : (n, 3 (j + k), 2 d)
        Columns s and delta xi; rows are ordered as in `gap_derivative`, node by node.
    C : (n, 2 d, 2 d)
        Symmetric matrices.
    """
    n, d = len(at.gap), at.tangents.shape[2]
    g = at.gap[:, None, None]
    weights = np.concatenate([basis, -at.values], axis=1)
    t = weights[:, :, None, None] * at.tangents[:, None]
    none = np.zeros((n, basis.shape[1], 3, d))
    s = np.concatenate([none, at.derivatives[:, :, None] * at.normal[:, None, :, None]], axis=1)
    metric = np.einsum("nia,nib->nab", at.tangents, at.tangents)
    s, t = (array.reshape(n, 3 * weights.shape[1], d) for array in (s, t))
    xi = np.linalg.solve(metric - g * at.curvature, np.swapaxes(t + g * s, 1, 2))
    Q = np.concatenate([s, np.swapaxes(xi, 1, 2)], axis=2)
    b, inverse = at.curvature, g * np.linalg.inv(metric)
    unit = np.broadcast_to(np.eye(d), b.shape)
    C = np.block([[inverse, inverse @ b - unit], [b @ inverse - unit, b @ inverse @ b - b]])
    return Q, C
