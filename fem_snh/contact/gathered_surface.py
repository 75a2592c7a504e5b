"""Surfaces of a distributed body that every rank has as a whole: nodes, facets, positions.

Contact between two surfaces couples nodes of any two ranks. A surface has few nodes compared with
the body, so every rank gathers all of them, evaluates the same contact and adds the rows that it
owns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, identity, kron
from scipy.spatial import Delaunay

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace, Mesh
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.contact.surface_quadrature import SurfaceQuadrature, cross_tangents
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.mesh.mesh_checks import ON_AXIS


class GatheredNodes:
    """Nodes of a displacement space, in the same order on all ranks. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    nodes : (n,) int64
        Global nodes of V, owned by any rank, in any order; the union over the ranks is used.

    Attributes
    ----------
    nodes : (m,) int64
        The global nodes, sorted, each once.
    is_own : (m,) bool
        Whether this rank owns the node.
    X : (m, 3)
        Reference coordinates of ``nodes`` [m].
    """

    def __init__(self, V: FunctionSpace, nodes: Array) -> None:
        self._V, self.comm = V, V.mesh.comm  # the mesh frees its communicator
        numbers, owned = _dolfinx.local_to_global(V), _dolfinx.num_nodes(V)[0]
        self.nodes = np.unique(np.concatenate(self.comm.allgather(np.unique(nodes))))
        # Global numbers of a rank's own nodes are contiguous.
        first = int(numbers[0]) if owned else 0
        self.is_own = (self.nodes >= first) & (self.nodes < first + owned)
        self._own = self.nodes[self.is_own] - first
        self._counts = np.array(self.comm.allgather(len(self._own)))
        self.X = self.gather(V.tabulate_dof_coordinates()[:owned])

    def gather(self, values: Array) -> Array:
        """Return the values at ``nodes``, (m, c), of ``values`` (local nodes, c). Collective."""
        # The nodes are sorted and each rank's own ones contiguous: the ranks follow each other.
        own = np.ascontiguousarray(values[self._own])
        found = np.empty((len(self.nodes), own.shape[1]), own.dtype)
        self.comm.Allgatherv(own, [found, self._counts * own.shape[1]])
        return found

    def add_own(self, values: Array, out: Array) -> None:
        """Add values at ``nodes`` (m, 3) to ``out`` (local nodes, c) where this rank owns them."""
        out[self._own] += values[self.is_own, : out.shape[1]]


#: Reference coordinates are rounded to this fraction of the surface's size before they are sorted,
#: so that the order of facets is the same on any number of ranks.
_ROUNDING = 1e-9
#: Distance on the reference facet below which two points are the same; nodes are > 1/4 apart.
_SAME = 1e-6
#: A map that makes one diagonal of a square the shorter one, so that the Delaunay triangulation is
#: unique.
_SHEAR = np.array([[1.0, 0.1], [0.1, 1.0]])


class FacetShape:
    """The shape functions of a facet, with the nodes in the order of `SurfaceQuadrature`.

    Parameters
    ----------
    kind : {"triangle", "quadrilateral", "interval"}
        The reference facet.
    degree : int
        Polynomial degree of the displacement.

    Attributes
    ----------
    kind : str
        The reference facet.
    nodes : (k, d)
        Reference coordinates of the nodes.
    simplices : (n, d + 1) int
        The nodes of triangles that divide the facet, anticlockwise; of a curve, of segments.
    center : (d,)
        Mean of the corners.
    rim : (n, d) int
        Pairs of neighbouring nodes around the facet, anticlockwise; of a curve its two ends.
    sense : (n,)
        1 or -1: the orientation, relative to the facet, of the triangle or segment from the center
        to each pair or end in ``rim``.
    """

    def __init__(self, kind: str, degree: int) -> None:
        self.kind, self._degree = kind, degree
        nodes = _dolfinx.reference_nodes(kind, degree)
        self._order = np.lexsort(np.round(nodes / _SAME).T)
        self.nodes = nodes[self._order]
        # Nodes of degree 3 are at 0.28 and 0.72 along edges, and at 1/3: nearest to the lattice's.
        lattice = np.rint(degree * self.nodes)
        if kind == "interval":
            order = np.argsort(lattice[:, 0])
            self.simplices = np.stack([order[:-1], order[1:]], axis=1)
        else:
            self.simplices = Delaunay(lattice @ _SHEAR).simplices
        self.center = _dolfinx.reference_corners(kind).mean(axis=0)
        arms = self.nodes - self.center
        if kind == "interval":
            self.rim = np.argsort(arms[:, 0])[[0, -1], None]
            self.sense = np.array([-1.0, 1.0])
            return
        turn = np.argsort(np.arctan2(arms[:, 1], arms[:, 0]))
        outline = turn[np.linalg.norm(arms, axis=1)[turn] > _SAME]
        self.rim = np.stack([outline, np.roll(outline, -1)], axis=1)
        self.sense = np.ones(len(outline))

    def evaluate(self, points: Array, order: int = 1) -> tuple[Array, ...]:
        """Return the shape functions at reference points (n, d), with derivatives up to ``order``.

        The tuple has ``order + 1`` arrays: values (n, k), first derivatives (n, k, d), second
        derivatives (n, k, d, d).
        """
        table = _dolfinx.tabulate_element(self.kind, self._degree, points, order)
        table = np.moveaxis(table[..., self._order], 0, -1)
        d = self.nodes.shape[1]
        found = table[..., 0], table[..., 1 : 1 + d]
        if order < 2:
            return found[: order + 1]
        # basix's second derivatives are xx, xy, yy; of a curve xx.
        return *found, table[..., [[3, 4], [4, 5]] if d == 2 else [[2]]]

    def outside(self, points: Array) -> Array:
        """Return how far reference points (n, d) are outside of the facet; <= 0 inside."""
        sums = points.sum(axis=1) if self.kind == "triangle" else points.max(axis=1)
        return np.maximum(-points.min(axis=1), sums - 1)


@dataclass(frozen=True)
class Side:
    """The facets of one surface, the same on all ranks, in an order that depends on no partition.

    Attributes
    ----------
    nodes : (facets, k) int
        The nodes of each facet, as rows of ``GatheredSurface.X``.
    outward : (facets,)
        1 where the cross product of a facet's tangents points outward, -1 where it points inward.
    weights : (facets, points)
        Quadrature weights in the reference configuration [m^2].
    basis : (points, k)
        Shape functions at the quadrature points.
    derivatives : (points, k, d)
        Derivatives of the shape functions by the d coordinates of the reference facet.
    areas : (facets,)
        Areas of the facets in the reference configuration [m^2], of curves their lengths [m].
    own : (n,) int
        The facets whose cells this rank owns.
    """

    nodes: Array
    outward: Array
    weights: Array
    basis: Array
    derivatives: Array
    areas: Array
    own: Array

    def __len__(self) -> int:
        return len(self.nodes)

    @classmethod
    def joined(cls, first: Side, second: Side) -> Side:
        """Return the facets of one surface, then the facets of another one."""
        columns = [(side.nodes, side.outward, side.weights, side.areas) for side in (first, second)]
        nodes, outward, weights, areas = map(np.concatenate, zip(*columns, strict=True))
        own = np.concatenate([first.own, len(first) + second.own])
        return cls(nodes, outward, weights, first.basis, first.derivatives, areas, own)

    @property
    def mean_size(self) -> float:
        """The root of the facets' mean area, of curves the mean length [m]."""
        return float(self.areas.mean() ** (1 / self.derivatives.shape[2]))

    @property
    def sizes(self) -> Array:
        """The roots of the facets' areas, of curves the lengths, (facets,) [m]."""
        return np.asarray(self.areas ** (1 / self.derivatives.shape[2]))


class GatheredSurface(GatheredNodes):
    """The nodes and facets of several surfaces, on every rank. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    surfaces : sequence of SurfaceQuadrature
        Each rank's facets of each surface.

    Attributes
    ----------
    shape : FacetShape
        The shape functions of a facet.
    sides : list of Side
        The facets of each surface.
    components : int
        Components of the displacement.
    """

    def __init__(self, V: FunctionSpace, surfaces: Sequence[SurfaceQuadrature]) -> None:
        self.components = _dolfinx.num_components(V)
        kind = _dolfinx.FACET_OF[_dolfinx.cell_name(V.mesh)]
        self.shape = FacetShape(kind, _dolfinx.degree(V))
        numbers = _dolfinx.local_to_global(V)
        wanted = [numbers[surface.nodes.ravel()] for surface in surfaces]
        super().__init__(V, np.concatenate(wanted))
        X = V.tabulate_dof_coordinates()[: len(numbers)]
        self.sides = [self._side(X, numbers, surface) for surface in surfaces]

    def positions(self, u: Array) -> Array:
        """Return the deformed coordinates of ``nodes``, (m, 3) [m]. Collective.

        ``u`` are this rank's nodal displacements (local nodes, 3) [m].
        """
        return self.X + self.gather(u)

    def _side(self, X: Array, numbers: Array, surface: SurfaceQuadrature) -> Side:
        local = X[surface.nodes]
        tangents = np.einsum("fki,pkj->fpij", local, surface.derivatives, optimize=True)
        cross = cross_tangents(tangents)
        sign = np.sign(np.einsum("fpi,fpi->f", cross, surface.normals))
        mine = (numbers[surface.nodes], sign, surface.weights, surface.areas, local.mean(axis=1))
        gathered = self.comm.allgather(mine)
        nodes, outward, weights, areas, middles = map(np.concatenate, zip(*gathered, strict=True))
        size = float(np.abs(self.X - self.X.mean(axis=0)).max())
        order = np.lexsort(np.round(middles / (_ROUNDING * size)).T)
        before = sum(len(found[0]) for found in gathered[: self.comm.rank])
        own = np.flatnonzero((order >= before) & (order < before + len(surface.nodes)))
        return Side(
            np.searchsorted(self.nodes, nodes[order]),
            outward[order],
            weights[order],
            surface.basis,
            surface.derivatives,
            areas[order],
            own,
        )


class EmbeddedSurface:
    r"""Triangles whose points are linear functions of the nodal displacements. Collective.

    .. math:: x_i(u) = X_i + \sum_a W_{ia} u_a

    All arrays are the same on all ranks. In two dimensions segments take the place of triangles.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    points : (n, 3)
        Reference positions X [m].
    triangles : (m, 3) int
        Points of each triangle, anticlockwise seen from outside the body; (m, 2) of each segment.
    nodes : (n, k) int64
        Global nodes of V that each point depends on.
    weights : (n, k)
        The weight W of each of these nodes.

    Attributes
    ----------
    points, triangles, nodes, weights
        The parameters; ``triangles`` are int32.
    support : GatheredNodes
        The nodes that the points depend on.
    columns : (n, k) int
        ``nodes`` as indices of ``support.nodes``.
    matrix : (n, len(support.nodes)) scipy CSR matrix
        W, which maps values at the nodes of ``support`` to values at the points.
    components : int
        Components of the displacement.
    """

    def __init__(
        self, V: FunctionSpace, points: Array, triangles: Array, nodes: Array, weights: Array
    ) -> None:
        self.points, self.triangles = points, np.asarray(triangles, np.int32)
        self.nodes, self.weights, self.components = nodes, weights, _dolfinx.num_components(V)
        self.support = GatheredNodes(V, nodes.ravel())
        self.columns = np.searchsorted(self.support.nodes, nodes)
        starts = np.arange(len(nodes) + 1) * nodes.shape[1]
        self.matrix = csr_matrix(
            (weights.ravel(), self.columns.ravel(), starts),
            shape=(len(points), len(self.support.nodes)),
        )
        self._nodal_map = csr_matrix(self.matrix.T)

    @classmethod
    def boundary(cls, V: FunctionSpace, revolved: bool = False) -> EmbeddedSurface:
        """Return the boundary of V's mesh, each facet divided into triangles. Collective.

        The points are the nodes on the boundary. A triangular facet gives one triangle at degree 1
        and four at degree 2, a quadrilateral twice as many. The order of points and triangles does
        not depend on the number of ranks. If ``revolved``, facets on the axis x = 0 are left out.
        """
        surface = GatheredSurface(V, [SurfaceQuadrature(V, degree=1)])
        side = surface.sides[0]
        triangles = side.nodes[:, surface.shape.simplices]  # (facets, triangles, 3)
        flipped = side.outward < 0
        triangles[flipped] = triangles[flipped][..., ::-1]
        if revolved:
            size = np.abs(surface.X).max(initial=0.0)
            off_axis = surface.X[side.nodes, 0].max(axis=1) > ON_AXIS * size
            triangles = triangles[off_axis]
        # Points in the order in which the facets name them.
        used, first, index = np.unique(triangles, return_index=True, return_inverse=True)
        order = np.argsort(first)
        nodes = surface.nodes[used[order]]
        return cls(
            V,
            surface.X[used[order]],
            np.argsort(order)[index].reshape(-1, triangles.shape[-1]),
            nodes[:, None],
            np.ones((len(nodes), 1)),
        )

    @classmethod
    def of_skin(cls, V: FunctionSpace, skin: Skin) -> EmbeddedSurface:
        """Return a skin that follows the cells of a lattice. Collective.

        Parameters
        ----------
        V : dolfinx function space
            The displacement's space, on cells that are parallelepipeds.
        skin : Skin
            The skin.
        """
        domain = V.mesh
        points, rows = carried_points(domain, skin)
        corners = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)[rows]]
        # Corner 2^k of a hexahedron is the end of its k-th edge.
        edges = np.stack([corners[:, 1 << k] - corners[:, 0] for k in range(3)], axis=2)
        local = np.linalg.solve(edges, (skin.points[points] - corners[:, 0])[..., None])[..., 0]
        nodes = _dolfinx.local_to_global(V)[_dolfinx.node_dofs(V)[rows]]
        weights = _dolfinx.tabulate_values(V, local)
        parts = domain.comm.allgather((points, nodes, weights))
        order = np.argsort(np.concatenate([part[0] for part in parts]))
        nodes, weights = (np.concatenate([part[i] for part in parts])[order] for i in (1, 2))
        return cls(V, skin.points, skin.triangles, nodes, weights)

    def positions(self, u: Array) -> Array:
        """Return the positions of the points, (n, c) [m]. Collective.

        ``u`` are this rank's nodal displacements (local nodes, c) [m], c the number of their
        components. All ranks get the same bits.
        """
        moved = self.interpolate(self.support.gather(u))
        return np.asarray(self.points[:, : moved.shape[1]] + moved)

    def nodal(self, values: Array) -> Array:
        """Return the nodal forces, (m, c), at ``support.nodes`` of forces at the points (n, c)."""
        return np.asarray(self._nodal_map @ values)

    def add_own(self, values: Array, out: Array) -> None:
        """Add `nodal` of ``values`` to ``out`` (local nodes, c), at nodes that this rank owns."""
        self.support.add_own(self.nodal(values), out)

    def interpolate(self, values: Array) -> Array:
        """Return vectors at the points, (n, c), from vectors at ``support.nodes``, (m, c)."""
        return np.asarray(self.matrix @ values)


def embedded_surface(
    V: FunctionSpace, skin: Skin | None = None, revolved: bool = False
) -> EmbeddedSurface:
    """Return the surface on which a body touches itself. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    skin : Skin, optional
        The skin that a lattice carries. Default: the boundary of the mesh.
    revolved : bool
        Whether the mesh is a section that revolves about the axis x = 0.
    """
    if skin is None:
        return EmbeddedSurface.boundary(V, revolved)
    return EmbeddedSurface.of_skin(V, skin)


def triangle_areas(points: Array, triangles: Array) -> Array:
    """Return the areas of triangles [m^2], or the lengths of a curve's parts [m]."""
    corners = points[triangles]
    ways = corners[:, 1:] - corners[:, :1]
    if ways.shape[1] == 1:
        return np.asarray(np.linalg.norm(ways[:, 0], axis=1))
    return np.asarray(np.linalg.norm(np.cross(ways[:, 0], ways[:, 1]), axis=1) / 2)


def point_areas(points: Array, triangles: Array, revolved: bool = False) -> Array:
    r"""Return the area of each point of a surface, (n,) [m^2]: a third of its triangles' areas.

    In two dimensions it is half of the lengths of the point's segments, per thickness [m]; on a
    body of revolution :math:`\int N_i\, 2 \pi r\, ds` [m^2], with linear :math:`N_i`.

    Parameters
    ----------
    points : (n, 3)
        Positions [m].
    triangles : (m, 3) or (m, 2) int
        The triangles, or the segments, by their points.
    revolved : bool
        Whether the segments revolve about the axis x = 0.
    """
    count = triangles.shape[1]
    each = np.repeat(triangle_areas(points, triangles) / count, count)
    if revolved:
        r = np.maximum(points[triangles, 0], 0.0)  # rounding errors on the axis
        each *= (2 * np.pi * (r + r.sum(axis=1, keepdims=True)) / 3).ravel()
    return np.bincount(triangles.ravel(), each, len(points))


def carried_points(domain: Mesh, skin: Skin) -> tuple[Array, Array]:
    """Return the points of a skin that cells of this rank carry, and these owned cells, (n,)."""
    owned = _dolfinx.num_owned(domain)
    row_of = np.full(_dolfinx.num_cells(domain), -1)
    row_of[_dolfinx.input_cells(domain)[:owned]] = np.arange(owned)
    points = np.flatnonzero(row_of[skin.cells] >= 0)
    return points, row_of[skin.cells[points]]


class Blocks(NamedTuple):
    """The c x c blocks of a matrix in the rows of nodes that this rank owns.

    Attributes
    ----------
    rows, columns : (n,) int
        The nodes of each block, as indices of ``EmbeddedSurface.support.nodes``.
    values : (n, c, c)
        The blocks [N/m].
    """

    rows: Array
    columns: Array
    values: Array


class SurfaceMatrix:
    """This rank's rows of a surface's matrix, as `Blocks`, and a pattern that contains them.

    Parameters
    ----------
    surface : EmbeddedSurface
        The surface.

    Attributes
    ----------
    pairs : (n, 2) int64
        Global nodes of the pattern's blocks: see `BlockMatrix.couple`. It is the same array object
        until `replace` is called.
    """

    def __init__(self, surface: EmbeddedSurface) -> None:
        self._nodes, own = surface.support.nodes, surface.support.is_own
        self._own = np.flatnonzero(own)
        self._components = surface.components
        one = identity(self._components)
        weights = surface.matrix
        self._map = kron(weights, one, format="csr")
        self._own_map = kron(weights[:, self._own].T, one, format="csr")
        self._keys: Array = np.empty(0, np.int64)
        self.pairs: Array = np.empty((0, 2), np.int64)

    def blocks(self, matrix: Any) -> Blocks:
        """Return this rank's rows of W^T M W, for a sparse matrix M of the points, (c n, c n)."""
        return self._blocks(self._own_map @ (matrix @ self._map))

    def nodal(self, derivatives: Any) -> csr_matrix:
        """Return derivatives by the points' positions (n, c points) as those by the nodes'."""
        return csr_matrix(derivatives @ self._map)

    def products(self, derivatives: csr_matrix, factors: Array) -> Blocks:
        """Return this rank's rows of G^T diag(k) G for `nodal` derivatives G and factors k (n,)."""
        own = derivatives
        if len(self._own) < len(self._nodes):
            c = self._components
            own = derivatives[:, (c * self._own[:, None] + np.arange(c)).ravel()]
        scaled = derivatives.copy()
        scaled.data *= np.repeat(factors, np.diff(scaled.indptr))
        return self._blocks(own.T @ scaled)

    def _blocks(self, rows: Any) -> Blocks:
        """Return the blocks of this rank's rows, a sparse matrix (c own nodes, c nodes)."""
        found = csr_matrix(rows).tobsr((self._components,) * 2)
        rows = self._own[np.repeat(np.arange(len(self._own)), np.diff(found.indptr))]
        return Blocks(rows, found.indices, found.data)

    def contains(self, blocks: Blocks) -> bool:
        """Return whether the pattern has all of these blocks."""
        return bool(np.isin(self._key(blocks), self._keys, assume_unique=True).all())

    def replace(self, *patterns: Blocks) -> None:
        """Set the pattern to the union of several, and set ``pairs``."""
        self._keys = np.unique(np.concatenate([self._key(blocks) for blocks in patterns]))
        rows, columns = np.divmod(self._keys, len(self._nodes))
        self.pairs = np.stack([self._nodes[rows], self._nodes[columns]], axis=1)

    def add(self, blocks: Blocks, target: BlockMatrix) -> None:
        """Add blocks to a matrix, inside of `BlockMatrix.adding`."""
        rows, columns = self._nodes[blocks.rows], self._nodes[blocks.columns]
        target.add_couplings(rows[:, None], blocks.values, columns[:, None])

    def _key(self, blocks: Blocks) -> Array:
        return blocks.rows.astype(np.int64) * len(self._nodes) + blocks.columns
