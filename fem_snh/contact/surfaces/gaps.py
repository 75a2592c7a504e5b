r"""The gap between the quadrature points of one surface and the facets of another.

Each point x of the first surface has one facet of the other, which is constant during a solve. With
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

from fem_snh.contact.surfaces.gathered_surface import FacetShape, Side

Array = npt.NDArray[Any]

#: Newton's method for the closest point: reference coordinates change by less at the end ...
_CONVERGED = 1e-13
#: ... which it reaches in 1 iteration on flat triangles, in about 4 on curved facets.
_MAX_IT = 20
#: A closest point further outside of its facet, in reference coordinates, is no contact.
_OUTSIDE = 1.0


class Gaps(NamedTuple):
    r"""Closest points, gaps and what their derivatives are made of, of n points.

    Attributes
    ----------
    gap : (n,)
        The gap g [m].
    normal : (n, 3)
        The outward normal n of the facet.
    values : (n, k)
        Shape functions N_b at the closest points.
    derivatives : (n, k, 2)
        Their derivatives.
    tangents : (n, 3, 2)
        The tangents :math:`y_{,\alpha}` [m].
    curvature : (n, 2, 2)
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
    start : (n, 2)
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
        minor = curved[:, 0, 0] * curved[:, 1, 1] - curved[:, 0, 1] ** 2
        definite = (minor > 0) & (curved[:, 0, 0] > 0)
        matrix = np.where(definite[:, None, None], curved, metric)
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
    normal = np.cross(tangents[..., 0], tangents[..., 1]) * side.outward[facets, None]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    gap = np.einsum("ni,ni->n", normal, points - np.einsum("nk,nki->ni", values, y))
    outside = shape.outside(xi)
    gap[outside > _OUTSIDE] = np.inf
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
    Q : (n, 3 (j + k), 4)
        Columns s and delta xi, by the nodes of both facets.
    C : (n, 4, 4)
        Symmetric matrices.
    """
    n = len(at.gap)
    g = at.gap[:, None, None]
    weights = np.concatenate([basis, -at.values], axis=1)
    t = weights[:, :, None, None] * at.tangents[:, None]
    none = np.zeros((n, basis.shape[1], 3, 2))
    s = np.concatenate([none, at.derivatives[:, :, None] * at.normal[:, None, :, None]], axis=1)
    metric = np.einsum("nia,nib->nab", at.tangents, at.tangents)
    s, t = (array.reshape(n, 3 * weights.shape[1], 2) for array in (s, t))
    xi = np.linalg.solve(metric - g * at.curvature, np.swapaxes(t + g * s, 1, 2))
    Q = np.concatenate([s, np.swapaxes(xi, 1, 2)], axis=2)
    b, inverse = at.curvature, g * np.linalg.inv(metric)
    unit = np.broadcast_to(np.eye(2), b.shape)
    C = np.block([[inverse, inverse @ b - unit], [b @ inverse - unit, b @ inverse @ b - b]])
    return Q, C
