"""Samples of a body's surface, the deformed cells that contain them, the vertices around them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.cell_search import CellSearch, Hits
from fem_snh.assembly.regions import Region
from fem_snh.contact.closest_points import intersect
from fem_snh.contact.gathered_surface import EmbeddedSurface, triangle_areas
from fem_snh.contact.law import cell_moduli
from fem_snh.mesh.mesh import cell_volumes

#: Default stiffness, in E over the size of the cell. In the clip of docs/howto, closed by 0.25 from
#: either side, 10, 30 and 50 leave 3.8, 1.7 and 1.0 % of a cell, in 16 to 19 Newton iterations.
FACTOR = 50.0
#: With at least so many triangles for each face of a cell, in two dimensions segments for each
#: side, their corners are samples enough. Degree 1 has 2 and 1 of them, degree 2 has 8 and 2.
_PARTS_PER_FACE = {3: 6.0, 2: 1.5}
#: Barycentric coordinates of a triangle's corners, midpoints of its edges, and centre; of a
#: segment's ends and centre.
_POINTS = {
    3: np.concatenate([np.eye(3), (1 - np.eye(3)) / 2, np.full((1, 3), 1 / 3)]),
    2: np.concatenate([np.eye(2), np.full((1, 2), 1 / 2)]),
}
#: Weights of these points, relative to the area: of the corners alone, and of all (Zienkiewicz &
#: Taylor 2000, table 9.2, and Simpson's rule: exact for cubic functions). The deepest point of a
#: body in another one is a corner, or on an edge that crosses an edge
#: (`fem_snh.contact.reference_contact`).
_CORNERS = {3: np.array([1 / 3] * 3), 2: np.array([1 / 2] * 2)}
_ALL = {3: np.array([1 / 20] * 3 + [2 / 15] * 3 + [9 / 20]), 2: np.array([1, 1, 4]) / 6}
#: An edge or corner is sharp if its normal has a smaller cosine with that of one of its triangles.
SHARP = 0.9
#: Number of cells of equal volume in the cube, or square, whose edge is the size of each.
_CELLS_PER_CUBE = {"tetrahedron": 6.0, "hexahedron": 1.0, "triangle": 2.0, "quadrilateral": 1.0}


class SurfaceSamples:
    r"""Samples: quadrature points of a closed surface, shared by the triangles that meet there.

    A triangle t at a sample has a normal :math:`N_t` and gives the sample a part :math:`A_t` of its
    area. A sample acts on a face of normal n with the area that is projected on this face,

    .. math:: \sum_t A_t \langle -N_t \cdot n \rangle ,

    so that the sides of a block that stands on a floor add nothing to its base.

    Parameters
    ----------
    surface : EmbeddedSurface
        The surface.
    sizes : (points,)
        The size of the cells at the surface's points [m].
    revolved : bool
        Whether the surface is a curve that revolves about the axis x = 0.

    Attributes
    ----------
    triangle : (n,) int
        One triangle at each sample, in two dimensions a segment.
    coordinates : (n, corners)
        Barycentric coordinates of the sample in this triangle.
    areas : (n,)
        Quadrature weights in the reference configuration [m^2]; in a plane lengths [m].
    """

    def __init__(self, surface: EmbeddedSurface, sizes: Array, revolved: bool = False) -> None:
        self._surface, triangles = surface, surface.triangles
        areas, corners = triangle_areas(surface.points, triangles), triangles.shape[1]
        faces = sizes[triangles].mean(axis=1) ** (corners - 1)
        fine = faces.mean() >= _PARTS_PER_FACE[corners] * areas.mean()
        weights = (_CORNERS if fine else _ALL)[corners]
        # Corners are numbered as points, edges by their ends, centres by their triangle.
        n = np.int64(len(surface.points))
        keys = [triangles, (n * (n + 1) + np.arange(len(triangles)))[:, None]]
        if corners == 3:
            ends = np.sort(triangles[:, [[1, 2], [2, 0], [0, 1]]], axis=2).astype(np.int64)
            keys.insert(1, n + n * ends[..., 0] + ends[..., 1])
        numbers = np.concatenate(keys, axis=1)[:, : len(weights)]
        _, first, sample = np.unique(numbers, return_index=True, return_inverse=True)
        self.triangle, which = np.divmod(first, len(weights))
        self.coordinates = _POINTS[corners][which]
        parts = np.outer(areas, weights)
        if revolved:
            # The mean of r with the shape function of each sample as a weight: not 0 on the axis.
            means = (1 + np.eye(2)) / 3 if fine else _POINTS[corners]
            radii = np.maximum(surface.points[triangles, 0], 0.0)  # rounding errors
            parts *= 2 * np.pi * (radii @ means.T)
        #: The samples' parts of the triangles' areas, (samples, triangles) sparse.
        entries = sample.ravel(), np.repeat(np.arange(len(triangles)), len(weights))
        self._parts = csr_matrix((parts.ravel(), entries), shape=(len(first), len(triangles)))
        self.areas = np.asarray(self._parts.sum(axis=1)).ravel()

    def __len__(self) -> int:
        return len(self.triangle)

    def at(self, x: Array) -> Array:
        """Return values at the samples (n, ...), interpolated from x at the surface's points."""
        return surface_values(x, self._surface.triangles[self.triangle], self.coordinates)

    def facing(self, samples: Array, normals: Array, outward: Array) -> Array:
        """Return the areas (m,) [m^2] with which samples (m,) act on faces with normals (m, dim).

        ``outward`` (triangles, dim) are the present normals of the surface.
        """
        rows, triangles, areas = self._around(samples)
        against = -np.einsum("ni,ni->n", outward[triangles], normals[rows])
        return np.bincount(rows, areas * np.maximum(against, 0.0), len(samples))

    def directions(self, samples: Array, normals: Array, outward: Array) -> tuple[Array, Array]:
        """Return the normals with which samples (m,) may face another surface.

        Parameters
        ----------
        samples : (m,) int
            Samples.
        normals : (m, dim)
            Unit normals of the surface at these samples.
        outward : (triangles, dim)
            Unit normals of the surface's triangles.

        Returns
        -------
        rows : (k,) int
            Indices of ``samples``.
        directions : (k, dim)
            The sample's normal; at a sharp edge or corner also the normal of each triangle there.
        """
        rows, triangles, _ = self._around(samples)
        around = outward[triangles]
        cosine = np.einsum("ni,ni->n", around, normals[rows])
        sharp = np.zeros(len(samples), bool)
        sharp[rows[cosine < SHARP]] = True
        also = sharp[rows]
        rows = np.concatenate([np.arange(len(samples)), rows[also]])
        return rows, np.concatenate([normals, around[also]])

    def _around(self, samples: Array) -> tuple[Array, Array, Array]:
        """Return each triangle at ``samples``: index of the sample, triangle, part of its area."""
        parts = self._parts[samples]
        return np.repeat(np.arange(len(samples)), np.diff(parts.indptr)), parts.indices, parts.data


def surface_values(x: Array, corners: Array, coordinates: Array) -> Array:
    """Interpolate x (points, ...) at barycentric coordinates in n triangles; return (n, ...).

    ``corners`` (n, k) int are the points of each triangle, ``coordinates`` (n, k) their weights.
    """
    return np.asarray(np.einsum("nk,nk...->n...", coordinates, x[corners]))


def cell_sizes(V: FunctionSpace) -> Array:
    """Return the size of each owned cell, (cells,) [m].

    It is the edge of a cube of the volume of a hexahedron or of six tetrahedra, in two dimensions
    of a square of the area of a quadrilateral or of two triangles.
    """
    factor = _CELLS_PER_CUBE[_dolfinx.cell_name(V.mesh)]
    return np.asarray((factor * cell_volumes(V.mesh)) ** (1 / _dolfinx.mesh_dimension(V.mesh)[0]))


def cell_stiffness(V: FunctionSpace, regions: Sequence[Region]) -> Array:
    """Return `FACTOR` E/size of each owned cell, the default stiffness, (cells,) [Pa/m]."""
    return np.asarray(FACTOR * cell_moduli(V, regions) / cell_sizes(V))


def smallest_at_points(V: FunctionSpace, surface: EmbeddedSurface, values: Array) -> Array:
    """Return for each surface point the smallest value of the cells around it, (points,).

    ``values`` (owned cells,) are this rank's; the result is the same on all ranks. Collective.
    """
    nodes, smallest = _dolfinx.node_dofs(V), np.full(sum(_dolfinx.num_nodes(V)), np.inf)
    np.minimum.at(smallest, nodes.ravel(), np.repeat(values, nodes.shape[1]))
    numbers = _dolfinx.local_to_global(V)
    found = np.full(len(surface.support.nodes), np.inf)
    known = np.isin(numbers, surface.support.nodes)
    found[np.searchsorted(surface.support.nodes, numbers[known])] = smallest[known]
    found = np.min(V.mesh.comm.allgather(found), axis=0)
    return np.asarray(found[surface.columns].min(axis=1))


#: A node is on an entity of its cell whose vertices have larger shape functions of degree 1 there.
_ZERO = 1e-9


class Neighbourhood:
    """The vertices of cells, and those on which a surface's points depend. Collective.

    Vertices are numbered as global nodes of the displacement's space. A point that depends on a
    node inside an edge, facet or cell depends on the vertices of this edge, facet or cell.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    surface : EmbeddedSurface
        The surface.

    Attributes
    ----------
    cells : (cells, nodes) CSR matrix of bool
        The vertices of each cell that this rank owns.
    triangles : (m, nodes) CSR matrix of bool
        The vertices on which each triangle of the surface depends; the same on all ranks.
    """

    def __init__(self, V: FunctionSpace, surface: EmbeddedSurface) -> None:
        comm, kind, support = V.mesh.comm, _dolfinx.cell_name(V.mesh), surface.support.nodes
        nodes = _dolfinx.local_to_global(V)[_dolfinx.node_dofs(V)]
        vertices = nodes[:, : len(_dolfinx.reference_corners(kind))]
        size = comm.allreduce(_dolfinx.num_nodes(V)[0])
        self.cells = _incidence(vertices, size)
        reference = _dolfinx.reference_nodes(kind, _dolfinx.degree(V))
        table = _dolfinx.tabulate_element(kind, 1, reference, 0)[0]
        node, vertex = np.nonzero(np.abs(table) > _ZERO)
        pairs = np.stack([nodes[:, node].ravel(), vertices[:, vertex].ravel()], axis=1)
        pairs = np.unique(pairs[np.isin(pairs[:, 0], support)], axis=0)  # of several cells
        pairs = np.concatenate(comm.allgather(pairs))
        entries = np.searchsorted(support, pairs[:, 0]), pairs[:, 1]
        carriers = csr_matrix((np.ones(len(pairs), bool), entries), shape=(len(support), size))
        self._points = _incidence(surface.columns, len(support)) @ carriers
        self.triangles = self.around(surface.triangles)

    def around(self, points: Array, used: Array | None = None) -> csr_matrix:
        """Return the vertices on which sets of surface points depend, (n, nodes) CSR of bool.

        ``points`` (n, k) are the points of each of n sets. ``used`` (n, k) bool tells which of them
        count; default: all.
        """
        found = csr_matrix(_incidence(points, self._points.shape[0], used) @ self._points)
        found.eliminate_zeros()
        found.sort_indices()
        return found

    def share(self, triangle: Array, cell: Array) -> Array:
        """Return whether each triangle and cell, by number (n,), share a vertex, (n,) bool."""
        return intersect(self.triangles, triangle, self.cells, cell)


def _incidence(columns: Array, size: int, used: Array | None = None) -> csr_matrix:
    """Return the matrix (n, size) of bool that is true in the columns (n, k) of each row."""
    n, k = columns.shape
    values = np.ones(n * k, bool) if used is None else used.ravel()
    starts = np.arange(n + 1) * k
    found = csr_matrix((values, columns.flatten(), starts), shape=(n, size))  # a copy is sorted
    found.sum_duplicates()  # sorts, too
    found.eliminate_zeros()
    return found


#: Points outside a deformed cell by at most this, in reference coordinates, are found too, as they
#: may touch in the next solve.
OUTSIDE = 0.1


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

    def __init__(self, V: FunctionSpace) -> None:
        self.nodes = _dolfinx.node_dofs(V)
        self._search = CellSearch(_dolfinx.cell_name(V.mesh), _dolfinx.degree(V), self.nodes)
        self._X = V.tabulate_dof_coordinates()[:, : _dolfinx.mesh_dimension(V.mesh)[0]]

    def find(self, u: Array, points: Array, excluded: Any) -> tuple[Hits, Array]:
        """Return the cells that contain points, and the points' reference positions (n, dim) [m].

        Cells that are inverted at a point do not count. ``u`` (local nodes, dim) are nodal
        displacements [m]; ``points`` and ``excluded`` are those of `CellSearch.find`, whose margin
        is `OUTSIDE`.
        """
        x = self._X + u
        hits = self._search.find(x, points, OUTSIDE, excluded)
        (X, before), (_, after) = (
            self._search.evaluate(values, hits.cell, hits.xi) for values in (self._X, x)
        )
        upright = before * after > 0
        return Hits(*(values[upright] for values in hits)), X[upright]
