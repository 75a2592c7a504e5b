"""The term of self-contact by a map to the reference configuration (Smith et al. 2018, section 6).

Samples of the surface that are inside deformed cells are pushed to targets on the surface. Where
sharp edges cross, no sample of either edge is inside the other body: a spring connects the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.connected_parts import connected_parts
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region
from fem_snh.contact.closest_points import Normals, PseudoNormals, intersect
from fem_snh.contact.gathered_surface import Blocks, EmbeddedSurface, SurfaceMatrix, triangle_areas
from fem_snh.contact.samples import (
    OUTSIDE,
    SHARP,
    DeformedCells,
    Neighbourhood,
    SurfaceSamples,
    cell_sizes,
    cell_stiffness,
    smallest_at_points,
    surface_values,
)
from fem_snh.contact.surface_contact import SelfContactTerm
from fem_snh.contact.triangle_search import CloserTargets, ReferenceSurface, approaching
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.terms.history import SETTLED, LaggedChange, relative

#: A sample found in two cells counts once if its two reference positions are closer than this
#: fraction of a cell: the cells are neighbours.
_SAME = 0.5
#: Samples in front of another part of the surface, closer to it than this fraction of a cell, get
#: springs, too, as they may touch in the next solve. Without these, the flesh of a finger that
#: bends passes through itself by 2.7 cells in a solve: the scene hand, step 35, takes 47 Newton
#: iterations instead of 22. With an entire cell, blocks of two cells
#: (tests/contact/test_reference_contact.py) tilt.
_APPROACH = 0.5
#: A target is taken to be on a sharp edge only if its sample is farther than this fraction of a
#: cell from the normal line through the target: in two blocks of one width rounding decides.
_BESIDE = 1e-6
#: Least area with which a sample acts, relative to its own: below, the target's face is parallel.
_ACTS = 1e-9
#: Area with which an edge acts where it crosses another one, over the sum of its triangles' areas.
_EDGE_AREA = 1 / 3


@dataclass(frozen=True, eq=False)
class ContactSprings:
    r"""Springs between samples and targets, constant during a solve; the same on all ranks.

    With the positions of sample and target, :math:`x_s` and :math:`x_t`, the lagged outward normal
    n at the target and the gap :math:`g = n \cdot (x_s - x_t)`, negative in contact, the energy is

    .. math:: E = \sum \tfrac{c}{2} \langle -g \rangle^2 .

    It is convex in the displacement, and its forces sum to zero, as the weights of a sample and of
    a target have the same sum. In two dimensions the surface has segments in place of triangles,
    and vectors have two components; the shapes given are for three dimensions.

    Attributes
    ----------
    num_points : int
        The number of the surface's points.
    sample : (n,) int
        The sample of each pair, sorted; a crossing edge i counts as sample (number of samples) + i.
    target : (n,) int
        The triangle in which the target is.
    corners : (n, 6) int
        Points of the surface: of the sample's triangle, then of the target's triangle.
    factors : (n, 6)
        Weights of these points in :math:`x_s - x_t`.
    normal : (n, 3)
        Outward unit normal n of the surface at the target.
    stiffness : (n,)
        Stiffness c of the springs [N/m].
    """

    num_points: int
    sample: Array
    target: Array
    corners: Array
    factors: Array
    normal: Array
    stiffness: Array

    @classmethod
    def none(cls, num_points: int, dim: int) -> ContactSprings:
        """Return an empty set of pairs for a surface of ``num_points`` points."""
        integers = np.empty(0, int)
        corners = np.empty((0, 2 * dim), int)
        factors, normal = np.empty((0, 2 * dim)), np.empty((0, dim))
        return cls(num_points, integers, integers, corners, factors, normal, np.empty(0))

    def __len__(self) -> int:
        return len(self.sample)

    def __getitem__(self, chosen: Array) -> ContactSprings:
        """Return the pairs at some indices, or where a mask is true."""
        return ContactSprings(self.num_points, *(column[chosen] for column in self._columns))

    def joined(self, other: ContactSprings) -> ContactSprings:
        """Return the union of these pairs and others, sorted by sample."""
        both = [np.concatenate(pair) for pair in zip(self._columns, other._columns, strict=True)]
        return ContactSprings(self.num_points, *both)[np.argsort(both[0], kind="stable")]

    def find(self, other: ContactSprings, x: Array, distance: float) -> Array:
        """Return for each pair one of ``other`` with the same sample and a target close by.

        Parameters
        ----------
        other : ContactSprings
            Other pairs.
        x : (points, 3)
            The positions of the surface's points [m].
        distance : float
            Largest distance between the two targets [m].

        Returns
        -------
        (n,) int
            Indices of ``other``; -1 where it has no such pair.
        """
        found, mine, others = np.full(len(self), -1), self.ends(x)[1], other.ends(x)[1]
        first = np.searchsorted(other.sample, self.sample)
        counts = np.searchsorted(other.sample, self.sample, side="right") - first
        for number in range(counts.max(initial=0)):
            some = np.flatnonzero(counts > number)
            candidate = first[some] + number
            near = np.linalg.norm(mine[some] - others[candidate], axis=1) <= distance
            found[some[near]] = candidate[near]
        return found

    def ends(self, x: Array) -> tuple[Array, Array]:
        """Return the positions of the samples and of their targets, (n, 3) each [m].

        ``x`` (points, 3) are the positions of the surface's points, deformed or reference ones.
        """
        weighted, dim = self.factors[..., None] * x[self.corners], self.normal.shape[1]
        return weighted[:, :dim].sum(axis=1), -weighted[:, dim:].sum(axis=1)

    @property
    def _columns(self) -> tuple[Array, ...]:
        return self.sample, self.target, self.corners, self.factors, self.normal, self.stiffness

    def gaps(self, x: Array) -> Array:
        """Return the gaps (n,) [m], negative in contact, at positions x (points, 3)."""
        return np.asarray(self.derivatives @ x.ravel())

    @cached_property
    def derivatives(self) -> csr_matrix:
        """Return the derivatives of the gaps by the points' positions, (n, 3 points). Cached."""
        values, dim = self.factors[..., None] * self.normal[:, None], self.normal.shape[1]
        columns = dim * self.corners[..., None] + np.arange(dim)
        indptr = np.arange(len(self) + 1) * 2 * dim**2
        shape = (len(self), dim * self.num_points)
        return csr_matrix((values.ravel(), columns.ravel(), indptr), shape=shape)


class NodalSprings:
    """`ContactSprings` as functions of displacements v (m, dim) [m] of the surface's support.

    The gaps are linear in v, so that no evaluation needs the surface's points.

    Parameters
    ----------
    springs : ContactSprings
        The springs.
    surface : EmbeddedSurface
        The surface.
    matrix : SurfaceMatrix
        The matrix of the surface.

    Attributes
    ----------
    springs : ContactSprings
        The springs.
    """

    def __init__(
        self, springs: ContactSprings, surface: EmbeddedSurface, matrix: SurfaceMatrix
    ) -> None:
        self.springs, self._matrix, self._stiffness = springs, matrix, springs.stiffness
        self._derivatives = matrix.nodal(springs.derivatives)
        self._gaps = springs.gaps(surface.points[:, : springs.normal.shape[1]])

    def gaps(self, v: Array) -> Array:
        """Return the gaps (n,) [m], negative in contact."""
        return np.asarray(self._gaps + self._derivatives @ v.ravel())

    def energy(self, v: Array) -> float:
        """Return the energy [J]."""
        return float(self._stiffness @ np.minimum(self.gaps(v), 0.0) ** 2) / 2

    def forces(self, v: Array) -> Array:
        """Return the magnitudes of the springs' forces, (n,) [N]: 0 without contact."""
        return np.asarray(-self._stiffness * np.minimum(self.gaps(v), 0.0))

    def gradient(self, v: Array) -> Array:
        """Return the energy's derivative by v, (m, dim) [N]."""
        return np.asarray(-(self._derivatives.T @ self.forces(v)).reshape(v.shape))

    def hessian(self, v: Array) -> Blocks:
        """Return this rank's rows of the energy's Hessian by v [N/m]."""
        acting = np.flatnonzero(self.gaps(v) < 0)
        return self._matrix.products(self._derivatives[acting], self._stiffness[acting])

    def add_hessian(self, v: Array, filter: str, target: BlockMatrix) -> int:
        """Add the Hessian, which is positive semidefinite: nothing is filtered."""
        self._matrix.add(self.hessian(v), target)
        return 0

    def pattern(self) -> Blocks:
        """Return nonnegative blocks with the entries of `hessian` if all pairs touched."""
        return self._matrix.products(abs(self._derivatives), np.ones(len(self._stiffness)))


class TargetSearch:
    """Samples of a surface, and the search for their targets. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    surface : EmbeddedSurface
        The surface.
    regions : sequence of Region
        The materials.
    stiffness : float, optional
        Contact pressure over penetration [Pa/m]. Default: the smaller `cell_stiffness` of sample
        and target.
    overlap : bool
        Whether cells of one body overlap in the reference configuration, as cells of a lattice do
        where parts of its surface pass through one cube.
    revolved : bool
        Whether the body is a section that revolves about the axis x = 0.

    Attributes
    ----------
    samples : SurfaceSamples
        The samples.
    stiffness : float
        The mean stiffness over the surface [Pa/m].
    size : float
        The mean size of the cells at the surface [m].
    """

    def __init__(
        self,
        V: FunctionSpace,
        surface: EmbeddedSurface,
        regions: Sequence[Region],
        stiffness: float | None = None,
        overlap: bool = False,
        revolved: bool = False,
    ) -> None:
        self._comm, self._surface, self._overlap = V.mesh.comm, surface, overlap
        self._sizes = cell_sizes(V)
        sizes = smallest_at_points(V, surface, self._sizes)
        self.samples = SurfaceSamples(surface, sizes, revolved)
        if stiffness is None:
            values = smallest_at_points(V, surface, cell_stiffness(V, regions))
        else:
            values = np.full(len(surface.points), stiffness)
        self._stiffness = values
        areas = self.samples.areas / self.samples.areas.sum()
        self.stiffness, self.size = (float(areas @ self.samples.at(v)) for v in (values, sizes))
        self._cells, self._dim = DeformedCells(V), surface.triangles.shape[1]
        self._near, corners = Neighbourhood(V, surface), surface.triangles[self.samples.triangle]
        #: Vertices around each sample and each edge. Nothing that shares a vertex touches.
        self._around = self._near.around(corners, self.samples.coordinates > 0)
        if self._dim == 3:  # the parts of a curve cross at their points alone
            areas = triangle_areas(surface.points, surface.triangles)
            self._edges = SurfaceEdges(surface.triangles)
            self._edge_areas = _EDGE_AREA * areas[self._edges.triangles].sum(axis=1)
            self._around_edges = self._near.around(self._edges.points)
        self._sample_sizes = self.samples.at(sizes)
        bodies = connected_parts(V)[0]
        self._cell_bodies = bodies[self._cells.nodes[:, 0]]
        of_points = surface.support.gather(bodies[:, None])[surface.columns[:, 0], 0]
        points, triangles = surface.points[:, : self._dim], surface.triangles
        self._reference = ReferenceSurface(points, triangles, of_points[triangles[:, 0]])
        self._normals, self._closer = PseudoNormals(triangles), CloserTargets(triangles)

    def find(self, u: Array, x: Array) -> ContactSprings:
        """Return the pairs of samples inside the body or close to its surface, and of edges.

        Collective; the same on all ranks.

        Parameters
        ----------
        u : (local nodes, dim)
            Nodal displacements [m].
        x : (points, dim)
            The positions of the surface's points [m].
        """
        samples, triangles = self.samples, self._surface.triangles
        points, surface = samples.at(x), self._normals.of(x)
        outward, normals = surface.outward, surface.at(samples.triangle, samples.coordinates)
        hits = np.concatenate(self._comm.allgather(self._own_hits(u, x, points, normals, outward)))
        hits = _without_repeated(hits)
        others = self._approaching(x, points, normals, outward, hits[:, 0])
        others = np.concatenate(self._comm.allgather(others))
        hits = np.concatenate([hits[:, np.r_[0, 3 : 4 + self._dim]], others])
        hits = hits[np.argsort(hits[:, 0], kind="stable")]
        sample, target, coordinates = hits[:, 0].astype(int), hits[:, 1].astype(int), hits[:, 2:]
        corners = np.concatenate([triangles[samples.triangle[sample]], triangles[target]], axis=1)
        factors = np.concatenate([samples.coordinates[sample], -coordinates], axis=1)
        normal = self._target_normals(x, sample, points[sample], target, coordinates, surface)
        areas = samples.facing(sample, normal, outward)
        springs = self._springs(corners, factors, areas)
        pairs = ContactSprings(len(x), sample, target, corners, factors, normal, springs)
        pairs = pairs[areas > _ACTS * samples.areas[sample]]
        return pairs.joined(self._crossing_edges(x, outward)) if self._dim == 3 else pairs

    def penetration(self, pairs: ContactSprings, x: Array) -> float:
        """Return the largest penetration [m], >= 0, at positions x of the surface's points.

        A sample in the body penetrates by its distance from the closest point of the surface around
        its target, two edges by how far they have passed each other. No point of a surface of flat
        triangles is deeper than its corners and crossing edges.
        """
        gaps = pairs.gaps(x)
        crossing = pairs.sample >= len(self.samples)
        inside = pairs[np.flatnonzero((gaps < 0) & ~crossing)]
        points, none = inside.ends(x)[0], np.zeros(len(inside))
        outward = self._normals.of(x).outward
        target, place = self._closer.move(points, 0 * points, none, inside.target, x, outward)
        closest = surface_values(x, self._surface.triangles[target], place)
        depths = np.linalg.norm(points - closest, axis=1)
        return float(max(depths.max(initial=0.0), -gaps[crossing].min(initial=0.0)))

    def scale_stiffness(self, factor: float) -> None:
        """Multiply the stiffness of the springs that `find` returns from now on."""
        self._stiffness, self.stiffness = factor * self._stiffness, factor * self.stiffness

    def _springs(self, corners: Array, factors: Array, areas: Array) -> Array:
        """Return the stiffness (n,) [N/m] of springs that act with areas (n,) [m^2].

        ``corners`` and ``factors`` (n, 2 dim) are those of `ContactSprings`.
        """
        values, dim = np.abs(factors) * self._stiffness[corners], self._dim
        # Where two surfaces touch, the samples of both have half of the stiffness each.
        return np.asarray(
            areas * np.minimum(values[:, :dim].sum(axis=1), values[:, dim:].sum(axis=1)) / 2
        )

    def _target_normals(
        self,
        x: Array,
        sample: Array,
        points: Array,
        target: Array,
        coordinates: Array,
        surface: Normals,
    ) -> Array:
        """Return the unit normals (n, dim) of the surface at targets.

        If the target is on a sharp edge or corner, and the sample off the triangle's normal there,
        the normal is the edge's or corner's. Otherwise it is averaged over smoothly adjacent
        triangles, so that it does not jump where a sample slides from triangle to triangle.
        """
        smooth = surface.averaged(target, coordinates, SHARP)
        edges = surface.at(target, coordinates)
        outward = surface.outward
        arm = points - surface_values(x, self._surface.triangles[target], coordinates)
        across = arm - np.einsum("ni,ni->n", arm, outward[target])[:, None] * outward[target]
        beyond = np.linalg.norm(across, axis=1) > _BESIDE * self._sample_sizes[sample]
        beyond &= np.einsum("ni,ni->n", edges, outward[target]) < SHARP
        return np.where(beyond[:, None], edges, smooth)

    def _own_hits(self, u: Array, x: Array, points: Array, normals: Array, outward: Array) -> Array:
        """Return the samples in this rank's cells and their targets, (n, 4 + 2 dim).

        Columns: sample, distance outside the reference cell, cell size, triangle, barycentric
        coordinates (dim), reference position (dim). ``points`` and ``normals`` are the samples'
        positions and normals, ``outward`` the triangles' normals.
        """

        def excluded(sample: Array, cell: Array) -> Array:
            return intersect(self._around, sample, self._near.cells, cell)

        hits, X = self._cells.find(u, points, excluded)
        sample, size, bodies = hits.point, self._sizes[hits.cell], self._cell_bodies[hits.cell]
        own, normals = points[sample], normals[sample]
        sizes = self._sample_sizes[sample]
        found = self._reference.closest(X, bodies, normals, sizes, outward)
        target, depth = found.triangle, found.depth
        kept = depth >= -OUTSIDE * size
        # Below its own part of the surface a sample is in a compressed cell, not in contact.
        for triangle in (found.nearest, target):
            kept &= ~intersect(self._around, sample, self._near.triangles, triangle)
        if self._overlap:
            # A target in the sample's own part of the body, if it is closer than the edge of a
            # cube, is on a cube that touches the sample's one.
            kept &= (depth > size) | self._near.share(target, hits.cell)
        target, coordinates = self._closer.move(own, normals, sizes, target, x, outward)
        kept &= ~intersect(self._around, sample, self._near.triangles, target)
        columns = (sample, np.maximum(hits.outside, 0.0), size, target)
        rows = np.column_stack([*columns, coordinates, X])
        return np.asarray(rows[kept].reshape(-1, 4 + 2 * self._dim))

    def _approaching(
        self, x: Array, points: Array, normals: Array, outward: Array, inside: Array
    ) -> Array:
        """Return this rank's share of samples that may touch in the next solve, (n, 2 + dim).

        Columns: sample, triangle, barycentric coordinates (dim). The arguments are those of
        `_own_hits`, and ``inside``, the samples inside the body, which are left out.
        """
        samples, (rank, ranks) = self.samples, (self._comm.rank, self._comm.size)
        first, last = (len(samples) * (rank + i) // ranks for i in (0, 1))
        chosen = np.setdiff1d(np.arange(first, last), inside.astype(int))
        rows, directions = samples.directions(chosen, normals[chosen], outward)
        owner, corners = chosen[rows], x[self._surface.triangles]
        found = approaching(points[owner], directions, corners, outward, _APPROACH * self.size)
        sample = owner[found.sample]
        apart = ~intersect(self._around, sample, self._near.triangles, found.triangle)
        order = np.lexsort((found.distance, sample))
        order = order[apart[order]]
        _, closest = np.unique(sample[order], return_index=True)
        order = order[closest]
        columns = sample[order], found.triangle[order], found.coordinates[order]
        return np.asarray(np.column_stack(columns).reshape(-1, 2 + self._dim))

    def _crossing_edges(self, x: Array, outward: Array) -> ContactSprings:
        """Return the springs between edges that cross, or may cross in the next solve."""
        edges, triangles = self._edges, self._surface.triangles
        found = edges.crossings(x, outward, _APPROACH * self.size)
        apart = ~intersect(self._around_edges, found.first, self._around_edges, found.second)
        first, second, places, normal, facing = (column[apart] for column in found)
        corners, factors = [], []
        for edge, place, sign in ((first, places[:, 0], 1), (second, places[:, 1], -1)):
            corners.append(triangles[edges.triangles[edge, 0]])
            ends = edges.points[edge]
            parts = [
                (corners[-1] == ends[:, [i]]) * w[:, None] for i, w in ((0, 1 - place), (1, place))
            ]
            factors.append(sign * sum(parts))
        both = np.concatenate(corners, axis=1), np.concatenate(factors, axis=1)
        springs = self._springs(
            *both, facing * (self._edge_areas[first] + self._edge_areas[second])
        )
        # Edges are numbered after the samples.
        sample, target = len(self.samples) + first, edges.triangles[second, 0]
        return ContactSprings(len(x), sample, target, *both, normal, springs)


def _without_repeated(hits: Array) -> Array:
    """Return the rows of `TargetSearch._own_hits` by sample, one for each reference position."""
    # Rounded, as ranks may differ by rounding errors.
    first = hits.shape[1] // 2 + 2  # the first column of the reference position
    order = np.lexsort((*np.round(hits[:, first:] / hits[:, 2:3], 6).T, hits[:, 1], hits[:, 0]))
    hits = hits[order]
    repeated = np.zeros(len(hits), bool)
    for shift in range(1, len(hits)):
        same = hits[shift:, 0] == hits[:-shift, 0]
        if not same.any():
            break
        apart = np.linalg.norm(hits[shift:, first:] - hits[:-shift, first:], axis=1)
        repeated[shift:] |= same & (apart < _SAME * hits[shift:, 2]) & ~repeated[:-shift]
    return np.asarray(hits[~repeated])


#: An edge is sharp if the normals of its two triangles have a smaller cosine. Where other edges
#: cross, a point is deeper by at most tan(10 degrees) times half an edge than the samples on them.
_SHARP = np.cos(np.radians(20.0))
#: Edges whose angle has a smaller sine are parallel, and touch along their length.
_PARALLEL = np.sin(np.radians(1.0))
#: Greatest depth of a crossing, relative to the smallest height of the edges' triangles. A wedge is
#: solid behind its edge only as far as its faces extend: there a body of one cell has another edge.
_DEPTH = 0.5


class Crossings(NamedTuple):
    """Pairs of edges that cross, or may cross in the next solve.

    Attributes
    ----------
    first, second : (n,) int
        The two edges of each pair, first < second.
    place : (n, 2)
        Their closest points: the position along either edge, from 0 to 1.
    normal : (n, 3)
        Unit normal to both edges, outward from the body of the second edge.
    facing : (n,)
        The smallest cosine, > 0, of the normal with the second edge's conormals, and of its
        opposite with the first edge's: near 0 if two blocks touch at a face.
    """

    first: Array
    second: Array
    place: Array
    normal: Array
    facing: Array


class SurfaceEdges:
    """The edges of a closed surface that have exactly two triangles.

    Parameters
    ----------
    triangles : (m, 3) int
        The points of each triangle.

    Attributes
    ----------
    points : (n, 2) int
        The ends of each edge.
    triangles : (n, 2) int
        The two triangles of each edge.
    opposite : (n, 2) int
        The corner of each of these triangles that is not on the edge.
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

    def crossings(self, x: Array, outward: Array, distance: float) -> Crossings:
        """Return the pairs of sharp convex edges that cross, or are closer than a distance.

        The contact normal is normal to both edges. It must be between the normals of the faces at
        one edge, and its opposite between the normals of the faces at the other edge: otherwise two
        wedges touch at their faces.

        Parameters
        ----------
        x : (points, 3)
            Positions of the surface's points [m].
        outward : (triangles, 3)
            Unit normals of the triangles.
        distance : float
            Largest gap between the edges along the normal [m].
        """
        a, b = x[self.points[:, 0]], x[self.points[:, 1]]
        normals = outward[self.triangles]
        behind = np.einsum("ni,ni->n", normals[:, 0], x[self.opposite[:, 1]] - a)
        cosine = np.einsum("ni,ni->n", normals[:, 0], normals[:, 1])
        sharp = np.flatnonzero((cosine < _SHARP) & (behind < 0))
        middle, along = (a + b)[sharp] / 2, (b - a)[sharp]
        length = np.linalg.norm(along, axis=1)
        i, j = _close(middle, length, distance)
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

        A conormal is a unit vector in a triangle, normal to the edge, that points out of the
        triangle; the height [m] is the triangle's height over the edge.
        """
        across = np.cross(along[:, None], normals)
        across /= np.maximum(np.linalg.norm(across, axis=2, keepdims=True), np.finfo(float).tiny)
        inward = x[self.opposite[chosen]] - x[self.points[chosen, 0]][:, None]
        height = np.einsum("nki,nki->nk", across, inward)
        return -np.sign(height)[..., None] * across, np.abs(height).min(axis=1)


def _close(middle: Array, length: Array, distance: float) -> tuple[Array, Array]:
    """Return pairs of edges i < j, (n,) each and sorted, that may be within a distance [m]."""
    reach = length.max(initial=0.0) + distance
    pairs = cKDTree(middle).query_pairs(reach, output_type="ndarray")
    i, j = pairs[np.lexsort(pairs.T[::-1])].T
    near = np.linalg.norm(middle[i] - middle[j], axis=1) <= (length[i] + length[j]) / 2 + distance
    return i[near], j[near]


def _closest(start: Array, along: Array, i: Array, j: Array) -> tuple[Array, Array, Array]:
    """Return the closest points of the lines through edges i and j, and their common normal.

    Returns
    -------
    point : (n, 2)
        Positions along both lines, in lengths of the edges.
    normal : (n, 3)
        Unit normal to both lines.
    sine : (n,)
        Sine of the angle between the lines.
    """
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


#: After _FREE_SEARCHES of a step a sample keeps a target that would move by less than _MOVED cells,
#: after _SEARCHES_TO_MOVE any target: between two close triangles of different normals it would
#: alternate for ever.
_FREE_SEARCHES, _SEARCHES_TO_MOVE, _MOVED = 1, 2, 0.25


def _relative_change(before: Array, after: Array) -> float:
    """Return the largest change of nodal forces over the largest force, in units of SETTLED."""
    largest = max(np.abs(before).max(initial=0.0), np.abs(after).max(initial=0.0))
    return relative(np.abs(after - before).max(initial=0.0), largest, SETTLED)


class ReferenceContact(SelfContactTerm):
    """The energy of contact of a body with itself, and of the bodies of a mesh. Collective.

    Samples of the surface that are inside deformed cells are mapped to the reference configuration
    by these cells. A sample's target is the closest point of the surface there, or a closer one
    that a local search on the deformed surface finds; a spring pushes the sample out through its
    target. Samples that approach the surface have a target, too. Sharp edges that cross have a
    spring between them. Targets and normals are constant during a solve. After a solve the search
    is repeated, and the step is solved again until the forces have settled.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    skin : Skin or None
        The surface, if a lattice carries it; None for the boundary of the mesh.
    regions : sequence of Region
        The materials, which the default stiffness depends on.
    stiffness : float, optional
        Contact pressure over penetration [Pa/m]. Default: 50 E over the size of the cells.
    kinematics : Kinematics, optional
        A solid, a plane, or axisymmetric without torsion.
    """

    _coupled: bool
    _nodal_springs: NodalSprings

    def __init__(
        self,
        V: FunctionSpace,
        skin: Skin | None,
        regions: Sequence[Region],
        stiffness: float | None = None,
        kinematics: Kinematics = SOLID,
    ) -> None:
        super().__init__(V, skin, kinematics)
        revolved, overlap = kinematics.revolved, skin is not None
        self._search = TargetSearch(V, self.surface, regions, stiffness, overlap, revolved)
        none = ContactSprings.none(len(self.surface.points), kinematics.components)
        self._set_springs(self._on_nodes(none))
        self._searches, self._penetration, self._stale = 0, 0.0, True
        self._change = 0.0

    def set_load(self, load: float) -> None:
        """Have the next evaluation, at a step's predicted displacement, search for targets."""
        self._stale = True

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of the springs; return True.

        If it decreases, the next evaluation searches again: a stiffer state had other targets.
        """
        self._search.scale_stiffness(factor)
        stiffer = replace(self.springs, stiffness=factor * self.springs.stiffness)
        self._set_springs(self._on_nodes(stiffer))
        self._stale |= factor < 1
        return True

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of nodes that the Hessian couples: see `CouplingTerm`. Collective."""
        self.configuration(u)
        if not self._coupled:
            self._coupled = True
            pattern = self._nodal_springs.pattern()
            if not self._matrix.contains(pattern):
                self._matrix.replace(pattern)
        return self._matrix.pairs

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return ``{"self_contact": row}`` for run.json. Collective.

        ``pairs``, the number of springs that push; ``penetration`` [m] of the deepest point of the
        surface after the last solve; ``force`` [N], the sum of the magnitudes of the springs'
        forces; ``stiffness`` [Pa/m], the mean over the surface; ``change`` of a nodal force, over
        the largest one, if all samples took the targets of another search.
        """
        v = self.configuration(u)
        row = {
            "pairs": int((self._nodal_springs.gaps(v) < 0).sum()),
            "penetration": self._penetration,
            "force": float(self._nodal_springs.forces(v).sum()),
            "stiffness": self._search.stiffness,
            "change": self._change,
        }
        return {"self_contact": row}

    def spring_forces(self, u: PETSc.Vec) -> tuple[Array, Array, Array]:
        """Return the ends and forces of the springs that push; the same on all ranks. Collective.

        Returns
        -------
        samples, targets : (n, dim)
            Reference positions of the samples and of their targets [m].
        forces : (n,)
            Magnitudes of the springs' forces [N].
        """
        v = self.configuration(u)
        forces = self._nodal_springs.forces(v)
        samples, targets = self.springs.ends(self.surface.points[:, : v.shape[1]])
        return samples[forces > 0], targets[forces > 0], forces[forces > 0]

    def begin_step(self, u: PETSc.Vec) -> None:
        """Have the next evaluation, of the forces at a step's start, search for targets.

        These forces depend on the displacement alone, so that a resumed run has the same ones.
        """
        self._searches, self._stale = 0, True

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Search again and store the penetration; return the change of the forces. Collective.

        The springs change only if the forces have not settled.
        """
        v, x = self.configuration(u), self.surface.positions(self._nodal(u))
        before = self._nodal_springs.gradient(v)
        self._searches += 1
        new = self._search.find(self._nodal(u), x)
        self._penetration = self._search.penetration(new, x)
        updated = self._on_nodes(self._updated(new, x))
        ratio = _relative_change(before, updated.gradient(v))
        change = LaggedChange(ratio, "self_contact: the change of forces by another search")
        if not change.settled:  # else the pairs stay, with which the forces are in equilibrium
            self._set_springs(updated)
        elif self._searches > _FREE_SEARCHES:
            ratio = _relative_change(before, self._on_nodes(new).gradient(v))
        self._change = SETTLED * ratio
        return change

    def _updated(self, new: ContactSprings, x: Array) -> ContactSprings:
        """Return the pairs of a new search, with those former pairs that are kept."""
        old = self.springs
        if self._searches > _SEARCHES_TO_MOVE:
            return old.joined(new[~np.isin(new.sample, old.sample)])
        # A sample that its target has pushed out may come back in the next solve.
        kept = (old.gaps(x) >= 0) & ~np.isin(old.sample, new.sample)
        if self._searches > _FREE_SEARCHES:
            same = new.find(old, x, _MOVED * self._search.size)
            kept[same[same >= 0]] = True
            new = new[same < 0]
        return new.joined(old[kept])

    @property
    def springs(self) -> ContactSprings:
        """The present pairs of samples and targets."""
        return self._nodal_springs.springs

    def _on_nodes(self, springs: ContactSprings) -> NodalSprings:
        return NodalSprings(springs, self.surface, self._matrix)

    def _set_springs(self, springs: NodalSprings) -> None:
        self._nodal_springs, self.pairs, self._coupled = springs, [springs], False

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return the displacements (m, dim) [m] of the surface's support. Collective.

        If a search is due, it is done.
        """
        nodal = self._nodal(u)
        if self._stale:
            self._stale = False
            found = self._search.find(nodal, self.surface.positions(nodal))
            self._set_springs(self._on_nodes(found))
        return self.surface.support.gather(nodal)

    def add_nodal(self, values: Array, vector: PETSc.Vec) -> None:
        """Add vectors (m, c) of the surface's support to a ghosted vector. Collective."""
        self.surface.support.add_own(values, self._rows(vector))
