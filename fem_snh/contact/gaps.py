r"""The facets of a surface that are closest to points of another one, and the gaps between them.

Each point x of one surface has one facet of the other, which is constant during a solve. With
the facet's nodes at :math:`y_b`, the closest point is :math:`y(\xi) = \sum_b N_b(\xi) y_b`, where
:math:`(x - y) \cdot y_{,\alpha} = 0`, and the gap is :math:`g = n \cdot (x - y)` with the outward
normal n. With the metric :math:`m_{\alpha\beta} = y_{,\alpha} \cdot y_{,\beta}`, the curvature
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

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.contact.gathered_surface import FacetShape, Side
from fem_snh.contact.surface_quadrature import cross_tangents
from fem_snh.contact.triangle_search import Candidates, TriangleTree

Array = npt.NDArray[Any]

#: How many of the closest triangles' midpoints are examined: more where these few do not prove that
#: no other triangle is closer. Contact is with one of the closest hundred triangles, or with none.
_EXAMINED = (12, 48, 192)
#: Distances in radii of triangles below which two are equal.
_EQUAL = 1e-6
#: Rounding of barycentric coordinates on edges and at nodes.
_ON_EDGE = 1e-9
#: Newton's method for the closest point: reference coordinates change by less at the end ...
_CONVERGED = 1e-13
#: ... which it reaches in 1 iteration on flat triangles, in about 4 on curved facets.
_MAX_IT = 20
#: Added to a metric, relative to its trace, that a folded facet makes singular.
_SINGULAR = 1e-14
#: A closest point further outside of its facet, in reference coordinates, is no contact.
_OUTSIDE = 1.0


class FacetsInReach(NamedTuple):
    """The closest facets of some points.

    Attributes
    ----------
    facet : (n,) int
        The facet that a point may touch; -1 if there is none.
    start : (n, d)
        Approximate reference coordinates of the closest point on it.
    """

    facet: Array
    start: Array


class ClosestFacets:
    """A surface of triangles around the midpoint of each facet, and the search in it.

    Facets of degree 1 are searched as they are (a quadrilateral as four triangles), those of degree
    2 with their midside nodes (six or eight triangles). A curve is searched as two segments. The
    facet that is found is used with its own shape functions.

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
        normal = cross_tangents(np.swapaxes(T[:, 1:] - T[:, :1], 1, 2))
        normal *= (self._sense * self._side.outward[self._facet])[:, None]
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal /= np.maximum(length, np.finfo(float).tiny)
        tree = TriangleTree(T)
        equal = _EQUAL * tree.radius
        facet, start = np.full(len(points), -1), np.zeros((len(points), len(self._shape.center)))

        def receive(rows: Array, found: Candidates) -> Array:
            heights = np.einsum("nki,nki->nk", found.arm, normal[found.triangle])

            def closest(distances: Array) -> Array:
                """Return the closest triangle; of several the one that a point is most before."""
                smallest = distances.min(axis=1, keepdims=True)
                near = distances <= smallest + equal
                return np.asarray(np.where(near, np.abs(heights), -1.0).argmax(axis=1))

            row, facing = np.arange(len(rows)), np.where(found.cosine < 0, found.distance, np.inf)
            column = closest(facing)
            distance, height = facing[row, column], heights[row, column]
            chosen = found.choose(column)
            inside = heights[row, closest(found.distance)] <= equal
            # Barycentric coordinates: zero of the midpoint on the edge, one of a node at the node.
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
        tree.search(points, normals, normal, close, _EXAMINED, receive)
        return FacetsInReach(facet, start)


class Gaps(NamedTuple):
    r"""Closest points of n points, their gaps, and what the gaps' derivatives are made of.

    Attributes
    ----------
    gap : (n,)
        The gap g [m].
    normal : (n, 3)
        The outward normal n of the facet.
    values : (n, k)
        Shape functions N_b at the closest points.
    derivatives : (n, k, d)
        Their derivatives.
    tangents : (n, 3, d)
        The tangents :math:`y_{,\alpha}` [m].
    curvature : (n, d, d)
        The coefficients b [m].
    outside : (n,)
        How far the closest points are outside of their facets, in reference coordinates.
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
    """Return the gaps of points to the facets that are given for them.

    Parameters
    ----------
    shape : FacetShape
        The facets' shape functions.
    side : Side
        The facets.
    x : (m, 3)
        Positions of the nodes [m].
    points : (n, 3)
        Points of the other surface [m].
    facets : (n,) int
        Their facets.
    start : (n, d)
        First guess of the closest points.
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
    """Return dg of n points by the nodes of both facets, (n, j + k, 3).

    ``basis`` are the shape functions (n, j) of the points' own facets, whose nodes come first.
    """
    weights = np.concatenate([basis, -at.values], axis=1)
    return np.asarray(weights[:, :, None] * at.normal[:, None])


def gap_second_derivative(at: Gaps, basis: Array) -> tuple[Array, Array]:
    """Return the second derivatives of n gaps as products Q C Q^T.

    Returns
    -------
    Q : (n, 3 (j + k), 2 d)
        Columns s and delta xi, by the nodes of both facets.
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
