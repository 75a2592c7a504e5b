"""The deformed cells that contain given points, and where the points are in the reference state."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree
from scipy.special import comb, factorial

from fem_snh import _dolfinx

Array = npt.NDArray[Any]

#: Points that are outside of a deformed cell by this much in reference coordinates are found too:
#: they may touch in the next solve.
OUTSIDE = 0.1
#: Newton's method for the reference coordinates: its largest number of iterations, the distance
#: from the cell's midpoint at which it is kept, and the residual relative to the cell's size.
_ITERATIONS, _RANGE, _RESIDUAL = 15, 1.5, 1e-9
_SIMPLICES = "triangle", "tetrahedron"


class Hits(NamedTuple):
    """Points in deformed cells.

    Attributes
    ----------
    point, cell : (n,) int
        A point and a cell of this rank that contains it.
    X : (n, dim)
        The point's reference position in that cell [m].
    outside : (n,)
        How far the point is outside of the cell in reference coordinates; <= 0 inside.
    """

    point: Array
    cell: Array
    X: Array
    outside: Array


class DeformedCells:
    """The cells of a displacement space that this rank owns. Not collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.

    Attributes
    ----------
    nodes : (cells, k) int32
        Local nodes of each cell.
    """

    def __init__(self, V: Any) -> None:
        self._kind, self._degree = _dolfinx.cell_name(V.mesh), _dolfinx.degree(V)
        self.nodes = _dolfinx.node_dofs(V)
        self._center = _dolfinx.reference_corners(self._kind).mean(axis=0)
        self._X = V.tabulate_dof_coordinates()[:, : len(self._center)]
        self._control = _control_points(self._kind, self._degree)

    def find(self, u: Array, points: Array, excluded: Any) -> Hits:
        """Return the cells that contain points.

        Cells that are inverted at a point do not count: nothing is inside of them.

        Parameters
        ----------
        u : (local nodes, dim)
            Nodal displacements [m].
        points : (n, dim)
            Positions [m].
        excluded : callable
            Returns for points and cells (m,), by number, which pairs do not count, (m,) bool.
        """
        x = self._X + u
        point, cell = self._candidates(x, points)
        kept = ~excluded(point, cell)
        point, cell = point[kept], cell[kept]
        xi, found = self._invert(x[self.nodes[cell]], points[point])
        outside = self._outside(xi)
        found &= outside <= OUTSIDE
        point, cell, xi, outside = point[found], cell[found], xi[found], outside[found]
        nodes, table = self.nodes[cell], self._table(xi)
        det = [np.linalg.det(_jacobian(table, values[nodes])) for values in (self._X, x)]
        upright = det[0] * det[1] > 0
        X = np.einsum("nk,nki->ni", table[0], self._X[nodes])
        return Hits(point[upright], cell[upright], X[upright], outside[upright])

    def _candidates(self, x: Array, points: Array) -> tuple[Array, Array]:
        """Return the points in the boxes of cells, as points and cells (m,)."""
        none = np.empty(0, int)
        if not len(self.nodes) or not len(points):
            return none, none
        corners = np.einsum("bk,cki->cbi", self._control, x[self.nodes])
        low, high = corners.min(axis=1), corners.max(axis=1)
        middle, half = (low + high) / 2, (0.5 + OUTSIDE) * (high - low)
        # Most cells of a large body are far from its surface's points, and most pairs far apart.
        first, last = points.min(axis=0), points.max(axis=0)
        close = np.flatnonzero(((middle + half >= first) & (middle - half <= last)).all(axis=1))
        near = cKDTree(points).query_ball_point(
            middle[close], half[close].max(axis=1), p=np.inf, return_sorted=False
        )
        counts = np.fromiter(map(len, near), int, len(near))
        cell = np.repeat(close, counts)
        point = np.concatenate([none, *(found for found in near if found)]).astype(int)
        inside = (np.abs(points[point] - middle[cell]) <= half[cell]).all(axis=1)
        return point[inside], cell[inside]

    def _invert(self, x: Array, points: Array) -> tuple[Array, Array]:
        """Return the reference coordinates of points in cells, and whether they were found.

        ``x`` (n, k, dim) are the positions of the cells' nodes, ``points`` (n, dim).
        """
        xi = np.broadcast_to(self._center, points.shape).copy()
        found, size = np.zeros(len(points), bool), np.ptp(x, axis=1).max(axis=1)
        left = np.arange(len(points))
        for _ in range(_ITERATIONS):
            table = self._table(xi[left])
            rest = points[left] - np.einsum("nk,nki->ni", table[0], x[left])
            jacobian = _jacobian(table, x[left])
            done = np.linalg.norm(rest, axis=1) <= _RESIDUAL * size[left]
            found[left[done]] = True
            flat = np.finfo(float).eps * size[left] ** len(self._center)
            singular = np.abs(np.linalg.det(jacobian)) <= flat
            going = ~done & ~singular
            step = np.linalg.solve(jacobian[going], rest[going][..., None])[..., 0]
            left = left[going]
            if not len(left):
                break
            xi[left] = np.clip(xi[left] + step, self._center - _RANGE, self._center + _RANGE)
        return xi, found

    def _table(self, xi: Array) -> Array:
        """Return shape functions and their derivatives at points (n, dim), (1 + dim, n, k)."""
        return _dolfinx.tabulate_element(self._kind, self._degree, xi, 1)

    def _outside(self, xi: Array) -> Array:
        """Return how far points (n, dim) are outside of the reference cell."""
        upper = xi.sum(axis=1) if self._kind in _SIMPLICES else xi.max(axis=1)
        return np.maximum(-xi.min(axis=1), upper - 1)


def _jacobian(table: Array, x: Array) -> Array:
    """Return dx_i/dxi_j (n, dim, dim) of a table and positions of nodes x (n, k, dim)."""
    return np.einsum("jnk,nki->nij", table[1:], x)


def _control_points(kind: str, degree: int) -> Array:
    """Return the matrix (k, k) from a cell's nodes to the control points of its Bezier form.

    The cell is in their convex hull (Farin 2002, section 3.3), as its nodes' hull is for degree 1.
    """
    nodes = _dolfinx.reference_nodes(kind, degree)
    if degree == 1:
        return np.eye(len(nodes))
    powers = np.round(degree * nodes).astype(int)
    if kind in _SIMPLICES:
        powers = np.column_stack([degree - powers.sum(axis=1), powers])
        coordinates = np.column_stack([1 - nodes.sum(axis=1), nodes])
        factors = coordinates[:, None] ** powers
        count = factorial(degree) / factorial(powers).prod(axis=1)
        bernstein = count * factors.prod(axis=2)
    else:
        factors = nodes[:, None] ** powers * (1 - nodes[:, None]) ** (degree - powers)
        bernstein = (comb(degree, powers) * factors).prod(axis=2)
    return np.asarray(np.linalg.inv(bernstein))
