"""The search for the cells that contain points, in the reference or in a deformed configuration."""

from __future__ import annotations

import functools
from collections.abc import Callable
from math import comb, factorial
from typing import Any, NamedTuple

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import Mesh
from fem_snh.arrays import Array
from fem_snh.kernels import build
from fem_snh.kernels.build import cdata

#: Newton's method for the reference coordinates: the largest number of iterations, the largest
#: distance of each coordinate from the cell's midpoint, and the residual over the cell's size.
_ITERATIONS, _RANGE, _RESIDUAL = 15, 1.5, 1e-9
#: Points up to this far outside of a reference cell are inside, within rounding.
_INSIDE = 1e-8
#: Points up to this far outside of reference cells are compared with all these cells, not only with
#: the cell of the nearest centre: a curved surface has points outside of all cells.
_MARGIN = 0.25
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
        self.nodes = nodes
        self._control = _control_points(kind, degree)
        self._map = CellMap(kind, degree)

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

    def evaluate(self, x: Array, cells: Array, xi: Array) -> tuple[Array, Array]:
        """Return positions (n, dim) and det dx/dxi (n,) at ``xi`` (n, dim) in ``cells`` (n,).

        ``x`` (nodes, dim) are the positions of the nodes.
        """
        return self._map.evaluate(x[self.nodes[cells]], xi)

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
        return self._map.invert(x[self.nodes[cells]], points)

    def _candidates(self, x: Array, points: Array, margin: float) -> tuple[Array, Array]:
        """Return pairs of a point (m,) and a cell (m,) whose enlarged box contains the point."""
        none = np.empty(0, int)
        if not len(self.nodes) or not len(points):
            return none, none
        corners = np.einsum("bk,cki->cbi", self._control, x[self.nodes])
        low, high = corners.min(axis=1), corners.max(axis=1)
        middle, half = (low + high) / 2, (0.5 + margin) * (high - low)
        # Most cells of a large body are far from its surface's points.
        first, last = points.min(axis=0), points.max(axis=0)
        close = np.flatnonzero(((middle + half >= first) & (middle - half <= last)).all(axis=1))
        point, box = points_in_boxes(
            points, middle[close] - half[close], middle[close] + half[close]
        )
        return point, close[box]


@functools.cache
def _library() -> Any:
    """Open the library, compiled unless the cache has it. Not collective."""
    values = {"ITERATIONS": _ITERATIONS, "RANGE": _RANGE, "RESIDUAL": _RESIDUAL}
    definitions = [f"#define {name} {value}" for name, value in values.items()]
    return build.open_library(["cell_search_api.h"], ["cell_search_kernels.h"], definitions)


def points_in_boxes(points: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return all pairs of a point and a box around it: two arrays (k,) int, box by box.

    ``points`` (n, dim), and the boxes' lowest and highest coordinates (m, dim).
    """
    count, (n, d) = 0, points.shape
    room = 32 * n  # its memory is touched only if it is needed
    while True:
        point, box = np.empty((2, room), np.int32)
        count = _library()[1].points_in_boxes(
            d, n, cdata(points), len(low), cdata(low), cdata(high), room,
            cdata(point, np.int32), cdata(box, np.int32),
        )  # fmt: skip
        if count <= room:
            return point[:count].astype(int), box[:count].astype(int)
        room = count


class CellMap:
    """The map from a reference cell to a cell, for many cells at a time.

    Parameters
    ----------
    kind : str
        Kind of cell.
    degree : int
        Degree of the shape functions, 1 to 3.
    """

    def __init__(self, kind: str, degree: int) -> None:
        nodes = _dolfinx.reference_nodes(kind, degree)
        powers = np.indices((degree + 1,) * nodes.shape[1]).reshape(nodes.shape[1], -1).T
        if kind in _SIMPLICES:
            powers = powers[powers.sum(axis=1) <= degree]
        # Of centred coordinates, for which the matrix is well conditioned.
        monomials = ((2 * nodes - 1)[:, None] ** powers).prod(axis=2)
        self._center = _dolfinx.reference_corners(kind).mean(axis=0)
        self._map = _library()[0].new("CellMap *")
        self._kept = cdata(powers, np.int32), cdata(np.linalg.inv(monomials))
        self._map.d, self._map.k = nodes.shape[1], len(nodes)
        self._map.simplex = kind in _SIMPLICES
        self._map.power, self._map.coefficient = self._kept

    def evaluate(self, y: Array, xi: Array) -> tuple[Array, Array]:
        """Return positions (n, dim) and det dx/dxi (n,) at ``xi`` (n, dim) in n cells.

        ``y`` (n, k, dim) are the positions of the cells' nodes.
        """
        x, det = np.empty_like(xi), np.empty(len(xi))
        _library()[1].map_points(self._map, len(xi), cdata(y), cdata(xi), cdata(x), cdata(det))
        return x, det

    def invert(self, y: Array, x: Array) -> tuple[Array, Array, Array]:
        """Return `CellSearch.invert` of points x (n, dim) in cells with nodes at y (n, k, dim)."""
        xi, outside = np.empty(x.shape), np.empty(len(x))
        found = np.empty(len(x), np.uint8)
        _library()[1].invert_map(
            self._map, len(x), cdata(y), cdata(x), cdata(self._center), cdata(xi), cdata(outside),
            build.pointer(_library()[0], found),
        )  # fmt: skip
        return xi, outside, found.astype(bool)


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
