"""The search for the cells that contain points, in the reference or in a deformed configuration."""

from __future__ import annotations

from collections.abc import Callable
from math import comb, factorial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh._dolfinx import Mesh

Array = npt.NDArray[Any]

#: Newton's method for the reference coordinates: the largest number of iterations, the largest
#: distance of each coordinate from the cell's midpoint, and the residual over the cell's size.
_ITERATIONS, _RANGE, _RESIDUAL = 15, 1.5, 1e-9
#: Points up to this far outside of a reference cell are inside, within rounding.
_INSIDE = 1e-8
#: Points up to this far outside of reference cells are compared with all these cells, not only with
#: the cell of the nearest centre: a curved surface has points outside of all cells.
_MARGIN = 0.25
#: Up to this number, points (such as probes) are compared with the boxes of all cells.
_FEW = 16
_SIMPLICES = "triangle", "tetrahedron"


class Hits(NamedTuple):
    """Pairs of a point and a cell that contains the point.

    Attributes
    ----------
    point, cell : (n,) int
        The numbers of the point and of the cell.
    xi : (n, dim)
        The point's coordinates in the reference cell.
    outside : (n,)
        How far the point is outside of the cell in reference coordinates; <= 0 inside.
    """

    point: Array
    cell: Array
    xi: Array
    outside: Array


class CellSearch:
    """A search for the cells that contain points. Not collective.

    Parameters
    ----------
    kind : str
        Kind of cell, e.g. "tetrahedron".
    degree : int
        Degree of the shape functions.
    nodes : (cells, k) int
        The nodes of each cell.
    """

    def __init__(self, kind: str, degree: int, nodes: Array) -> None:
        self.nodes, self._kind, self._degree = nodes, kind, degree
        self._center = _dolfinx.reference_corners(kind).mean(axis=0)
        self._control = _control_points(kind, degree)

    def find(
        self,
        x: Array,
        points: Array,
        margin: float,
        excluded: Callable[[Array, Array], Array] | None = None,
    ) -> Hits:
        """Return all pairs of a point and a cell that contains the point.

        Parameters
        ----------
        x : (nodes, dim)
            Positions of the nodes [m].
        points : (n, dim)
            Positions of the points [m].
        margin : float
            Points up to this far outside of a cell, in reference coordinates, count too.
        excluded : callable, optional
            ``excluded(point, cell)`` returns which pairs (m,) of numbers do not count, (m,) bool.
        """
        point, cell = self._candidates(x, points, margin)
        if excluded is not None:
            kept = ~excluded(point, cell)
            point, cell = point[kept], cell[kept]
        xi, outside, found = self.invert(x, points[point], cell)
        found &= outside <= margin
        return Hits(point[found], cell[found], xi[found], outside[found])

    def closest(self, x: Array, points: Array, margin: float) -> tuple[Array, Array, Array]:
        """Return for each point a cell that contains the point, or the closest cell.

        Parameters
        ----------
        x, points, margin
            See `find`. For a point farther than ``margin`` outside of all cells, the cell with the
            nearest centre is returned.

        Returns
        -------
        cell : (n,) int
            The cells.
        xi : (n, dim)
            The points' coordinates in the reference cells.
        outside : (n,)
            How far the points are outside, in reference coordinates; infinite without cells.
        """
        cells, xi = np.zeros(len(points), int), np.zeros(points.shape)
        outside = np.full(len(points), np.inf)
        if not len(self.nodes) or not len(points):
            return cells, xi, outside
        centers = x[self.nodes].mean(axis=1)

        def search(rows: Array, candidates: Array) -> None:
            """Try one candidate cell for each point of ``rows`` that is in no cell so far."""
            some = outside[rows] > _INSIDE
            rows, candidates = rows[some], candidates[some]
            at, distance, found = self.invert(x, points[rows], candidates)
            distance[~found] = np.maximum(distance[~found], _MARGIN)
            better = distance < outside[rows]
            chosen = rows[better]
            cells[chosen], xi[chosen] = candidates[better], at[better]
            outside[chosen] = distance[better]

        point, cell = self._candidates(x, points, margin)
        order = np.lexsort((np.linalg.norm(points[point] - centers[cell], axis=1), point))
        point, cell = point[order], cell[order]
        turn = np.arange(len(point)) - np.searchsorted(point, point)
        for number in range(turn.max(initial=-1) + 1):
            search(point[turn == number], cell[turn == number])
        if len(lost := np.flatnonzero(np.isinf(outside))):
            search(lost, _tree(centers).query(points[lost])[1])
        return cells, xi, outside

    def tabulate(self, xi: Array) -> Array:
        """Return shape functions and their derivatives at points (n, dim), (1 + dim, n, k)."""
        return _dolfinx.tabulate_element(self._kind, self._degree, xi, 1)

    def invert(self, x: Array, points: Array, cells: Array) -> tuple[Array, Array, Array]:
        """Return the reference coordinates of each point in one given cell.

        ``cells`` (n,) are the cells of ``points`` (n, dim).

        Returns
        -------
        xi : (n, dim)
            The reference coordinates.
        outside : (n,)
            See `Hits`.
        found : (n,) bool
            Whether Newton's method converged.
        """
        xi = np.broadcast_to(self._center, points.shape).copy()
        y = x[self.nodes[cells]]
        found, size = np.zeros(len(points), bool), np.ptp(y, axis=1).max(axis=1)
        left = np.arange(len(points))
        for _ in range(_ITERATIONS):
            table = self.tabulate(xi[left])
            rest = points[left] - np.einsum("nk,nki->ni", table[0], y[left])
            derivative = jacobian(table, y[left])
            done = np.linalg.norm(rest, axis=1) <= _RESIDUAL * size[left]
            found[left[done]] = True
            flat = np.finfo(float).eps * size[left] ** len(self._center)
            regular = np.abs(np.linalg.det(derivative)) > flat
            step = np.linalg.solve(derivative[regular], rest[regular][..., None])[..., 0]
            moved = left[regular]
            xi[moved] = np.clip(xi[moved] + step, self._center - _RANGE, self._center + _RANGE)
            left = left[regular & ~done]
            if not len(left):
                break
        upper = xi.sum(axis=1) if self._kind in _SIMPLICES else xi.max(axis=1)
        return xi, np.maximum(-xi.min(axis=1), upper - 1), found

    def _candidates(self, x: Array, points: Array, margin: float) -> tuple[Array, Array]:
        """Return pairs of a point (m,) and a cell (m,) whose enlarged box contains the point."""
        none = np.empty(0, int)
        if not len(self.nodes) or not len(points):
            return none, none
        corners = np.einsum("bk,cki->cbi", self._control, x[self.nodes])
        low, high = corners.min(axis=1), corners.max(axis=1)
        middle, half = (low + high) / 2, (0.5 + margin) * (high - low)
        # Most cells of a large body are far from its surface's points, and most pairs far apart.
        first, last = points.min(axis=0), points.max(axis=0)
        close = np.flatnonzero(((middle + half >= first) & (middle - half <= last)).all(axis=1))
        if len(points) <= _FEW:
            apart = np.abs(points[:, None] - middle[close])
            point, number = np.nonzero((apart <= half[close]).all(axis=2))
            return point, close[number]
        near = _tree(points).query_ball_point(
            middle[close], half[close].max(axis=1), p=np.inf, return_sorted=False
        )
        counts = np.fromiter(map(len, near), int, len(near))
        cell = np.repeat(close, counts)
        point = np.concatenate([none, *(found for found in near if found)]).astype(int)
        inside = (np.abs(points[point] - middle[cell]) <= half[cell]).all(axis=1)
        return point[inside], cell[inside]


def locate(domain: Mesh, points: Array) -> tuple[Array, Array, Array]:
    """Return `CellSearch.closest` of this rank's cells in the reference configuration.

    ``points`` are (n, 3) [m]. Not collective.
    """
    dim = _dolfinx.mesh_dimension(domain)[0]
    kind, degree = _dolfinx.cell_name(domain), _dolfinx.geometry_degree(domain)
    search = CellSearch(kind, degree, _dolfinx.geometry_dofs(domain))
    return search.closest(_dolfinx.geometry_x(domain)[:, :dim], points[:, :dim], _MARGIN)


def _tree(points: Array) -> Any:
    from scipy.spatial import cKDTree  # takes longer to import than a small solve

    return cKDTree(points)


def jacobian(table: Array, x: Array) -> Array:
    """Return dx_i/dxi_j (n, dim, dim) from `CellSearch.tabulate` and node positions (n, k, dim)."""
    return np.einsum("jnk,nki->nij", table[1:], x)


def _control_points(kind: str, degree: int) -> Array:
    """Return the matrix (k, k) that maps a cell's nodes to its Bezier control points.

    The cell is in the convex hull of these points (Farin 2002, section 3.3).
    """
    nodes = _dolfinx.reference_nodes(kind, degree)
    if degree == 1:
        return np.eye(len(nodes))
    powers = np.round(degree * nodes).astype(int)
    if kind in _SIMPLICES:
        powers = np.column_stack([degree - powers.sum(axis=1), powers])
        coordinates = np.column_stack([1 - nodes.sum(axis=1), nodes])
        factors = coordinates[:, None] ** powers
        count = factorial(degree) / np.vectorize(factorial)(powers).prod(axis=1)
        bernstein = count * factors.prod(axis=2)
    else:
        factors = nodes[:, None] ** powers * (1 - nodes[:, None]) ** (degree - powers)
        bernstein = (np.vectorize(comb)(degree, powers) * factors).prod(axis=2)
    return np.asarray(np.linalg.inv(bernstein))
