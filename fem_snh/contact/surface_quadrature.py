"""Quadrature on the boundary of a body: points, shape functions and weights of its facets."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace, Mesh
from fem_snh.arrays import Array
from fem_snh.contact.facet_loops import ALL, FacetLoops, Which

#: Distance on the reference facet below which two nodes are the same; nodes are > 1/4 apart.
_SAME = 1e-6

#: Intervals of the grid along an edge: the nodes of degree 1 and 2, and as many points between.
GRID_INTERVALS = 4
#: Intervals of two finer grids, on facets that may be deep between points of the coarser grid.
FINE_INTERVALS = 16, 64
#: Quadrature points miss a depth of more than this times their penetration. A linear gap that is
#: zero in the middle of a facet is 1.7 (2 x 2 points) or 2 times (3 points) as deep at a vertex.
_FACTOR = 2.0
#: A depth below this, in sizes of the facet, may be missed: it changes the force by a few percent
#: (docs/howto/obstacles.md).
_LEAST = 0.05


class SurfaceQuadrature:
    r"""Quadrature on this rank's boundary facets of a displacement space. Not collective.

    In two dimensions facets are curves, and vectors have a third component.

    The nodes of every facet are ordered such that one table of shape functions serves all facets.
    With the reference coordinates X and the nodal displacements u_a, the point q of a facet is at

    .. math:: x_q(u) = X_q + \sum_a N_a(\xi_q) u_a .

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space: Lagrange of degree 1 to 3.
    facets : (n,) int, optional
        Local numbers of facets; facets inside the body are ignored. Default: the whole boundary.
    degree : int, optional
        Polynomial degree that the rule integrates exactly. Default: the degree of products of two
        shape functions (3 points on triangles of degree 1, 6 of degree 2; 4 and 9 on
        quadrilaterals).
    revolved : bool, optional
        Whether the body is the mesh revolved about the axis x = 0: weights are of the whole turn.

    Attributes
    ----------
    cells : (facets,) int32
        The cell of each facet, which this rank owns.
    facets : (facets,) int32
        Local numbers of the facets.
    nodes : (facets, k) int32
        Local nodes of V on each facet, ghosts included.
    cell_nodes : (facets, k) int
        Indices of these nodes among the nodes of the cell.
    kind : {"triangle", "quadrilateral", "interval"}
        The reference facet.
    degree : int
        Degree of polynomials that the rule integrates exactly.
    points : (points, d)
        Quadrature points on the reference facet.
    basis : (points, k)
        Shape functions N_a at the points.
    derivatives : (points, k, d)
        Derivatives of the shape functions by the coordinates of the reference facet: d = 2, on a
        curve 1.
    weights : (facets, points)
        Quadrature weights in the reference configuration [m^2]; in a plane per thickness [m].
    areas : (facets,)
        Reference areas of the facets [m^2], of curves their lengths [m].
    sizes : (facets,)
        Roots of the areas, of curves their lengths [m].
    X : (facets, points, 3)
        Reference coordinates of the points [m].
    normals : (facets, points, 3)
        Unit normals in the reference configuration, which point out of the body.
    """

    def __init__(
        self,
        V: FunctionSpace,
        facets: Array | None = None,
        degree: int | None = None,
        revolved: bool = False,
    ) -> None:
        domain, order = V.mesh, _dolfinx.degree(V)
        cell = _dolfinx.cell_name(domain)
        self.num_nodes = sum(_dolfinx.num_nodes(V))
        self.facets, self.cells, local = _dolfinx.exterior_facets(domain)
        if facets is not None:
            chosen = np.isin(self.facets, facets)
            self.facets, self.cells, local = self.facets[chosen], self.cells[chosen], local[chosen]
        self.kind = kind = _dolfinx.FACET_OF[cell]
        self.degree = degree or 2 * order + (kind == "quadrilateral")
        self.points, weights = _dolfinx.quadrature(kind, self.degree)
        self.V, self._local, self._revolved = V, local, revolved

        origins, tangents = _dolfinx.facet_maps(cell)
        numbers = _facet_nodes(_dolfinx.reference_nodes(cell, order), origins, tangents)
        dofs = _dolfinx.node_dofs(V)
        self._num_cell_nodes = dofs.shape[1]
        self._first, self.cell_nodes = numbers[0], numbers[local]
        self.nodes = np.take_along_axis(dofs[self.cells], self.cell_nodes, axis=1)
        first = origins[0] + self.points @ tangents[0]
        self.basis = self._tabulate(self.points)
        self.derivatives = _dolfinx.tabulate(V, first)[:, numbers[0]] @ tangents[0].T
        self._rule = weights
        self._set_geometry(domain, origins, tangents)
        if revolved:
            self.weights *= 2 * np.pi * self.X[..., 0]

    def _set_geometry(self, domain: Mesh, origins: Array, tangents: Array) -> None:
        """Set weights, areas, sizes, coordinates, tangents and normals."""
        self.X = self._coordinates(self.points, ALL)
        x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)[self.cells]]
        dim = origins.shape[1]
        #: Derivatives of X by the coordinates of the reference facet, (facets, points, 3, d).
        self._tangents = np.empty((*self.X.shape, dim - 1))
        for number, (origin, tangent) in enumerate(zip(origins, tangents, strict=True)):
            mine = self._local == number
            points = origin + self.points @ tangent
            gradients = _dolfinx.tabulate_geometry(domain, points) @ tangent.T
            found = np.einsum("cni,pnj->cpij", x[mine], gradients, optimize=True)
            self._tangents[mine] = found
        normals = cross_tangents(self._tangents)
        areas = np.linalg.norm(normals, axis=2)
        self.weights = areas * self._rule
        self.areas: Array = self.weights.sum(axis=1)
        #: Lengths of the facets [m]: roots of the areas, (facets,).
        self.sizes = self.areas ** (1 / (dim - 1))
        outwards = self.X - x.mean(axis=1, keepdims=True)
        sign = np.sign(np.einsum("cpi,cpi->cp", normals, outwards))
        self.normals = normals * (sign / areas)[..., None]

    def __len__(self) -> int:
        return len(self.cells)

    @cached_property
    def loops(self) -> FacetLoops:
        """The compiled loops over the quadrature points."""
        size = _dolfinx.num_components(self.V), self._num_cell_nodes
        columns = self.nodes, self.basis, self.X, self.weights, self.cell_nodes
        return FacetLoops(*columns, size)

    def displacements(self, u: Array, which: Which = ALL) -> Array:
        """Return the displacement at the quadrature points of facets [m].

        Parameters
        ----------
        u : (local nodes, 3)
            Nodal displacements [m], ghosts included.
        which : (m,) int, optional
            Facets. Default: all.

        Returns
        -------
        (m, points, 3)
        """
        return self.loops.vectors(u, which, deformed=False)

    def positions(self, u: Array, which: Which = ALL) -> Array:
        """Return the deformed coordinates x_q(u), (m, points, 3) [m]: see `displacements`."""
        return self.loops.vectors(u, which, deformed=True)

    def deformed_weights(self, u: Array) -> Array:
        """Return the quadrature weights in the deformed configuration, (facets, points) [m^2].

        In a plane they are per reference thickness [m]. ``u`` is as in `displacements`.
        """
        tangents = self._tangents + np.einsum(
            "fki,pkj->fpij", u[self.nodes], self.derivatives, optimize=True
        )
        if self._revolved:
            # Along the circle, by the angle: x is the radius, the third component is along it too.
            x = self.positions(u)
            turn = 2 * np.pi * np.stack([-x[..., 2], 0 * x[..., 0], x[..., 0]], axis=-1)
            tangents = np.concatenate([tangents, turn[..., None]], axis=-1)
        return np.asarray(np.linalg.norm(cross_tangents(tangents), axis=2) * self._rule)

    def grid_positions(self, intervals: int, u: Array, which: Which = ALL) -> Array:
        """Return the deformed coordinates of `facet_grid` on facets, (m, n, 3) [m].

        ``u`` and ``which`` are as in `displacements`.
        """
        points = facet_grid(self.kind, intervals)
        if intervals == GRID_INTERVALS:
            return self._grid.vectors(u, which, deformed=True)
        x = self._coordinates(points, which)
        return np.asarray(x + self._tabulate(points) @ u[self.nodes[which]])

    @cached_property
    def _grid(self) -> FacetLoops:
        """Loops over the points of the coarsest grid."""
        points = facet_grid(self.kind)
        X = self._coordinates(points, ALL)
        return FacetLoops(self.nodes, self._tabulate(points), X)

    def _tabulate(self, points: Array) -> Array:
        """Return the shape functions (n, k) at points (n, d) of the reference facet."""
        origins, tangents = _dolfinx.facet_maps(_dolfinx.cell_name(self.V.mesh))
        table = _dolfinx.tabulate_values(self.V, origins[0] + points @ tangents[0])
        return np.asarray(table[:, self._first])

    def _coordinates(self, points: Array, which: Which) -> Array:
        """Return the coordinates X, (m, n, 3) [m], of points (n, d) in the reference facet."""
        domain, local = self.V.mesh, self._local[which]
        rows = _dolfinx.geometry_dofs(domain)[self.cells[which]]
        x = _dolfinx.geometry_x(domain)[rows]
        found = np.empty((len(local), len(points), 3))
        maps = zip(*_dolfinx.facet_maps(_dolfinx.cell_name(domain)), strict=True)
        for number, (origin, tangent) in enumerate(maps):
            mine = local == number
            table = _dolfinx.tabulate_geometry_values(domain, origin + points @ tangent)
            found[mine] = table @ x[mine]
        return found

    def add_vectors(self, values: Array, which: Which, out: Array) -> None:
        r"""Add :math:`\sum_q N_a(\xi_q) v_q` to nodal vectors.

        Parameters
        ----------
        values : (m, points, 3)
            Vectors v_q, times the quadrature weights.
        which : (m,) int
            The facets.
        out : (local nodes, components)
            Nodal vectors, ghosts included.
        """
        self.loops.add_vectors(values, which, out)


def cross_tangents(tangents: Array) -> Array:
    """Return the cross product (..., 3) of tangents (..., 3, d): if d = 1, of t and e_z."""
    if tangents.shape[-1] == 2:
        return np.cross(tangents[..., 0], tangents[..., 1])
    t = tangents[..., 0]
    return np.stack([t[..., 1], -t[..., 0], np.zeros_like(t[..., 0])], axis=-1)


def _facet_nodes(nodes: Array, origins: Array, tangents: Array) -> Array:
    """Return the nodes of each facet of the reference cell, in an order common to all facets.

    The result is (facets, k) int. ``nodes`` (n, dim) are the cell's reference coordinates, the
    other arguments `fem_snh._dolfinx.facet_maps`.
    """
    found = []
    for origin, tangent in zip(origins, tangents, strict=True):
        s = (nodes - origin) @ np.linalg.pinv(tangent)
        on = np.flatnonzero(np.abs(origin + s @ tangent - nodes).max(axis=1) < _SAME)
        found.append(on[np.lexsort(np.round(s[on] / _SAME).T)])
    return np.array(found)


class DeepestPoint(NamedTuple):
    """The deepest point of a surface in contact, not only among quadrature points.

    Contact acts at quadrature points inside the facets. A corner, an edge or a small obstacle may
    pass between them without a force. After a step the gap is therefore also evaluated at a grid on
    each facet, which contains its nodes. If an obstacle exerts no force and its distance leaves a
    doubt, finer grids follow. A corner of the other body between grid points is missed, as is part
    of an obstacle that is in contact elsewhere.

    Attributes
    ----------
    depth : float
        Depth at the point [m]; 0 if no point is inside.
    size : float
        Size of the point's facet [m], of its smallest one if several share the point; inf if the
        depth is 0.
    position : list of float
        Deformed coordinates of the point [m]; empty if the depth is 0.
    """

    depth: float = 0.0
    size: float = np.inf
    position: list[float] = []

    @classmethod
    def among(cls, gaps: Array, sizes: Array, x: Array) -> DeepestPoint:
        """Return the deepest of some points.

        Parameters
        ----------
        gaps : (facets, points)
            Signed distances [m], negative inside.
        sizes : (facets,)
            Sizes of the facets [m].
        x : (facets, points, 3)
            Positions [m].
        """
        lowest = float(gaps.min(initial=0.0))
        if lowest >= 0:
            return cls()
        facets, points = np.nonzero(gaps == lowest)
        i = sizes[facets].argmin()
        return cls(-lowest, float(sizes[facets[i]]), x[facets[i], points[i]].tolist())

    @staticmethod
    def deepest(points: Iterable[DeepestPoint]) -> DeepestPoint:
        """Return the deepest of several; of equal depths the one with the smallest facet."""
        return min(points, key=lambda p: (-p.depth, p.size, p.position))

    def row(self, penetration: float) -> dict[str, Any]:
        """Return the point's entries in a row of run.json.

        They are ``deepest``, its depth [m], and ``deepest_at``, its position, if it is much deeper
        than the ``penetration`` [m] of quadrature points.
        """
        unseen = self.depth > max(_FACTOR * penetration, _LEAST * self.size)
        return {"deepest": self.depth} | ({"deepest_at": self.position} if unseen else {})


def facet_grid(kind: str, intervals: int = GRID_INTERVALS) -> Array:
    """Return a grid's points on the reference facet, (n, d), with so many intervals per edge."""
    s = np.arange(intervals + 1)
    if kind == "interval":
        return s[:, None] / intervals
    points = np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1).reshape(-1, 2)
    if kind == "triangle":
        points = points[points.sum(axis=1) <= intervals]
    return points / intervals


def may_be_deep(gaps: Array, x: Array, sizes: Array, intervals: int) -> Array:
    """Return which facets may be deep between a grid's points but not at them, (facets,) bool.

    A signed distance changes by at most the length of a path, and no point of a facet is farther
    from the grid than half a diagonal of its cells. Deep is a depth that `DeepestPoint.row` locates
    if no quadrature point is inside.

    Parameters
    ----------
    gaps : (facets, points)
        Signed distances at the grid's points [m].
    x : (facets, points, 3)
        Deformed positions of these points [m].
    sizes : (facets,)
        Sizes of the facets [m].
    intervals : int
        The grid's intervals along an edge.
    """
    lowest, deep = gaps.min(axis=1, initial=np.inf), -_LEAST * sizes
    diagonals = np.linalg.norm(x.max(axis=1) - x.min(axis=1), axis=-1)
    found: Array = (lowest > deep) & (lowest < deep + diagonals / (2 * intervals))
    return found
