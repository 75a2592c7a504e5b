"""The term of contact between surfaces of one mesh, without friction, and its pairs of surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region
from fem_snh.contact.gathered_surface import GatheredSurface, Side
from fem_snh.contact.law import (
    ContactLaw,
    cell_heights,
    default_stiffness,
    mean_derivative,
    surface_mean,
)
from fem_snh.contact.surface_contact import ContactPair, SurfaceContact
from fem_snh.contact.surface_quadrature import (
    DeepestPoint,
    SurfaceQuadrature,
    cross_tangents,
    facet_grid,
)
from fem_snh.contact.triangle_search import (
    ClosestFacets,
    Gaps,
    gap_derivative,
    gap_second_derivative,
    measure_gaps,
)
from fem_snh.errors import bad_value
from fem_snh.kernels.cell_matrices import filter_matrices
from fem_snh.terms.history import LaggedChange, relative
from fem_snh.terms.term import CouplingTerm, MeanForceTerm

#: Added to the quadrature degree of products of shape functions, as shape functions of the other
#: surface have kinks inside a facet. It reduces the error of a uniform pressure to a third.
_QUADRATURE = 4


#: The fraction of the stiffness that each of the two surfaces has.
_SHARE = 0.5
#: The facets of points have settled when a new search changes no nodal force by more than this
#: fraction of the largest one.
_SETTLED = 1e-4
#: After this many searches of a step, a point keeps its facet while the closest point is outside
#: the reference facet by less than _KEPT: a point at an edge between two facets of different
#: normals would otherwise alternate between them for ever.
_FREE_SEARCHES, _KEPT = 3, 0.1
#: Reach of the search, in diagonals of the smaller surface: bodies may move by this in a step.
_REACH = 0.5
#: A checkpoint locates multipliers by points so far inside their body, in sizes of a facet, as
#: surfaces that touch have points at the same place.
_INSIDE = 1e-3
#: A point of a facet moves by at most this times the largest motion of the facet's nodes: the sum
#: of the absolute values of the shape functions, largest on triangles of degree 2.
_SPREAD = 5 / 3
#: Gap in sizes of a facet below which a point's facet is in the sparsity pattern before they touch.
_MARGIN = 0.5
#: Gap in sizes of a facet below which surfaces touch without a force: rounding.
_ZERO_GAP = 1e-10
#: Least gap at a step's start, in sizes of a facet, of a point that had no facet then.
_OPEN = 1e-6


class BodyPair(NamedTuple):
    """Two surfaces of the mesh that may touch.

    Attributes
    ----------
    name : str
        Name in run.json.
    first, second : (n,) int
        Local numbers of each surface's facets.
    stiffness : float or None
        Penalty stiffness [Pa/m]; None for the smaller one of the surfaces' mean defaults.
    augmented : bool
        Whether multipliers reduce the penetration below the tolerance.
    tolerance : float or None
        Largest penetration [m] with the augmented Lagrangian; None for the default.
    limits_force : bool
        See `fem_snh.contact.obstacle_contact.RigidContact`.
    """

    name: str
    first: Array
    second: Array
    stiffness: float | None = None
    augmented: bool = False
    tolerance: float | None = None
    limits_force: bool = True


class Touching(NamedTuple):
    """The n quadrature points of both surfaces that touch a facet of the other surface.

    Attributes
    ----------
    point : (n,) int
        The points, numbered facet by facet: rows of the law's arrays.
    facet : (n,) int
        The facet of the other surface that each point touches.
    gaps : Gaps
        The gaps of the points to these facets.
    energy, pressure, stiffness : (n,)
        `Response` of the law to these gaps.
    """

    point: Array
    facet: Array
    gaps: Gaps
    energy: Array
    pressure: Array
    stiffness: Array


class SurfacePair(ContactPair):
    """Contact of two surfaces: quadrature points of each touch facets of the other.

    All ranks evaluate the same contact. ``x`` are positions of the nodes of ``surface``, (m, 3)
    [m]. Facets of both surfaces are numbered together, those of the first surface first; points
    are numbered facet by facet. Each surface has half of the stiffness.

    In time, Newmark's method takes the mean pressure over a step, from the gaps at the step's start
    and end, each to the facet that is closest at that time. With mean derivatives of the gaps
    (`_mean_turn`) the forces do the work that the contact energy loses. The difference between the
    mean derivatives and the derivatives at the step's end is lagged.

    Parameters
    ----------
    pair : BodyPair
        Name and method.
    surface : GatheredSurface
        The nodes of all surfaces of the term.
    sides : tuple of two Side
        The facets of the first and of the second surface.
    default : float
        The default stiffness [Pa/m].
    height : float
        The mean height of the cells at the surfaces [m].

    Attributes
    ----------
    side : Side
        The facets of both surfaces.
    size : (points,)
        The mean size of the facets of each point's own surface [m].

    Raises
    ------
    BadInput
        If the two surfaces have a common node.
    """

    def __init__(
        self,
        pair: BodyPair,
        surface: GatheredSurface,
        sides: tuple[Side, Side],
        default: float,
        height: float,
    ) -> None:
        first, second = sides
        if len(np.intersect1d(first.nodes, second.nodes)):
            raise bad_value("contact.groups", pair.name, "two surfaces without a common node")
        self.side = side = Side.joined(first, second)
        law = ContactLaw(pair, "contact", side.weights.ravel(), np.full(1, default), height, _SHARE)
        super().__init__(pair.name, law)
        boxes = (np.ptp(surface.X[one.nodes.ravel()], axis=0) for one in sides)
        self._reach = _REACH * min(float(np.linalg.norm(box)) for box in boxes)
        self._surface, self._searches, self._num_first = surface, 0, len(first)
        self._first_nodes = np.unique(first.nodes)
        self.size = np.repeat([one.mean_size for one in sides], [one.weights.size for one in sides])
        self._closest = [ClosestFacets(surface.shape, other) for other in (second, first)]
        self._facet: Array = np.full(len(self.size), -1)
        self._start: Array = np.zeros((0, 2))
        self._evaluated: tuple[Array, tuple[Any, ...], Touching] | None = None

    def begin_step(self, x: Array) -> None:
        """Reset the law; store positions and facets at the step's start; `search` comes first."""
        self.law.begin_step()
        self._searches, self._turn = 0, np.zeros_like(x)
        self._before = x.copy(), self._facet.copy(), self._start.copy()
        self._evaluated = None

    def settle(self, x: Array) -> list[LaggedChange]:
        """Search again, update mean derivatives and multipliers; return their changes."""
        before, touched = self.gradient(x), self.touching(x)
        keep = _KEPT if self._searches >= _FREE_SEARCHES else None
        self._searches += 1
        self.search(x, keep)
        if self.mean_weight is not None:
            self._turn = self._mean_turn(x)
        after = self.gradient(x)
        largest = max(np.abs(before).max(initial=0.0), np.abs(after).max(initial=0.0))
        change = float(np.abs(after - before).max(initial=0.0))
        what = f"contact '{self.name}': the change of forces by another search"
        slid_off = bool((self._facet[touched.point[touched.pressure > 0]] < 0).any())
        changed = LaggedChange(relative(change, largest, _SETTLED), what, slid_off)
        return [changed, *self.law.settle(*self.acting(x))]

    def search(self, x: Array, keep: float | None = None) -> None:
        """Set the facet of each point, and the sparsity pattern of close facets.

        Parameters
        ----------
        x : (m, 3)
            Positions of the nodes [m].
        keep : float, optional
            A point keeps its facet while its closest point there is outside the reference facet by
            less than this. Default: all points get the closest facet.
        """
        facet, start = self._find(x, self.points(x), self.normals(x))
        if keep is not None:
            other = np.flatnonzero((self._facet >= 0) & (facet != self._facet))
            near = other[self._measure(x, other).outside < keep]
            facet[near], start[near] = self._facet[near], self._start[near]
        self._facet, self._start = facet, start
        self._searched, self._evaluated = x, None
        self._gap = np.full(len(facet), np.inf)
        some = np.flatnonzero(facet >= 0)
        self._gap[some] = self._measure(x, some).gap
        near = some[self._gap[some] < _MARGIN * self.size[some]]
        self._known = np.unique(self._keys(near))
        self._pairs: Array | None = None

    def points(self, x: Array) -> Array:
        """Return the positions of the quadrature points [m], (points, 3)."""
        return np.asarray((self.side.basis @ x[self.side.nodes]).reshape(-1, 3))

    def normals(self, x: Array, derivatives: Array | None = None) -> Array:
        """Return the outward unit normals at the quadrature points, (points, 3).

        With the ``derivatives`` (n, k, d) of shape functions at n other points of each facet, the
        normals are at those.
        """
        table = self.side.derivatives if derivatives is None else derivatives
        tangents = np.einsum("fki,pka->fpia", x[self.side.nodes], table, optimize=True)
        normals = cross_tangents(tangents) * self.side.outward[:, None, None]
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        return np.asarray(normals.reshape(-1, 3))

    def touching(self, x: Array) -> Touching:
        """Return the points with a pressure, and those with gap 0. The last result is cached."""
        averages = self.mean_weight is not None
        version = self.law.version, averages
        if self._evaluated and self._evaluated[1] == version:
            if np.array_equal(x, self._evaluated[0]):
                return self._evaluated[2]
        zero, reach = _ZERO_GAP * self.size, self._moved(x)
        if averages:
            reach = max(reach, self._moved(self._before[0]))
        close = (self._gap <= reach + zero) | (self.law.multipliers > 0)
        some = np.flatnonzero(close & (self._facet >= 0))
        gaps = self._measure(x, some)
        gap, start = gaps.gap, None
        if averages and not self.law.augmented:
            # Points far outside of their facets have infinite gaps.
            ends = self._at_start(some)[0].gap, gap
            start, gap = (np.minimum(end, self._reach) for end in ends)
        response = self.law.response(some, gap, start)
        which = response.pressure > 0
        if start is None:
            which |= gap <= zero[some]
        chosen, some = Gaps(*(values[which] for values in gaps)), some[which]
        found = Touching(some, self._facet[some], chosen, *(v[which] for v in response))
        self._evaluated = x, version, found
        return found

    def acting(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the points that touch, gaps [m] and pressures [Pa], (n,) each."""
        at = self.touching(x)
        return at.point, at.gaps.gap, at.pressure

    def energy(self, x: Array) -> float:
        """Return the energy [J]."""
        at = self.touching(x)
        energy = self.law.energy(at.point, at.energy)
        if self.mean_weight is not None:
            energy += float((self._turn * (x - self._before[0])).sum())
        return self.weight * energy

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative by the nodes' positions, (m, 3) [N]."""
        at = self.touching(x)
        forces = gap_derivative(at.gaps, self._basis(at))
        forces *= (-self.law.weights[at.point] * at.pressure)[:, None, None]
        nodes = self._nodes(at).ravel()
        columns = [np.bincount(nodes, forces[..., i].ravel(), len(x)) for i in range(3)]
        found = np.stack(columns, axis=1)
        return found if self.mean_weight is None else self.weight * (found + self._turn)

    def nodal_forces(self, x: Array) -> Array:
        """Return the nodal forces on the first surface, zero at other nodes, (m, 3) [N]."""
        forces = np.zeros_like(x)
        forces[self._first_nodes] = -self.gradient(x)[self._first_nodes]
        return forces

    def force_derivative(self, component: int, x: Array) -> Array:
        """Return the derivative of a component of the force on the first surface, (m, c) [N/m].

        Only rows of nodes that this rank owns are complete; c is the number of components.
        """
        c, translation = self._surface.components, np.zeros((len(x), self._surface.components))
        translation[self._first_nodes, component] = 1.0
        found = np.zeros_like(translation)
        nodes, matrices, _ = self.matrices(x, "exact")
        rows = np.searchsorted(self._surface.nodes, nodes)
        products = matrices @ translation[rows].reshape(len(rows), -1, 1)
        np.add.at(found, rows, -products.reshape(*rows.shape, c))
        return found

    def matrices(self, x: Array, filter: str) -> tuple[Array, Array, int]:
        """Return global nodes (n, k), filtered Hessians (n, c k, c k), and how many were filtered.

        c is the number of the displacement's components. There is one Hessian [N/m] for each pair
        of touching facets, with the nodes of both, if this rank owns one of them. Filters act at
        each point.
        """
        at = self.touching(x)
        mine = self._surface.is_own[self._nodes(at)].any(axis=1)
        gaps = Gaps(*(values[mine] for values in at.gaps))
        point, facet, _, *response = at
        at = Touching(point[mine], facet[mine], gaps, *(values[mine] for values in response))
        basis, nodes = self._basis(at), self._nodes(at)
        dg = gap_derivative(gaps, basis).reshape(len(nodes), 3 * nodes.shape[1])
        Q, C = gap_second_derivative(gaps, basis)
        # The eigenvalues of Q C Q^T are those of R C R^T, and zeros.
        Q, R = np.linalg.qr(Q)
        curved = R @ (-at.pressure[:, None, None] * C) @ np.swapaxes(R, 1, 2)
        curved, filtered = filter_matrices(curved, filter)
        found = at.stiffness[:, None, None] * dg[:, :, None] * dg[:, None]
        found += Q @ curved @ np.swapaxes(Q, 1, 2)
        found *= self.weight * self.law.weights[at.point, None, None]
        keys = self._keys(at.point)
        _, first, which = np.unique(keys, return_index=True, return_inverse=True)
        order = np.argsort(which.ravel(), kind="stable")
        starts = np.searchsorted(which.ravel()[order], np.arange(len(first)))
        found = np.add.reduceat(found[order], starts) if len(first) else found
        k, c = nodes.shape[1], self._surface.components
        found = found.reshape(-1, k, 3, k, 3)[:, :, :c, :, :c].reshape(-1, c * k, c * k)
        return self._surface.nodes[nodes[first]], found, filtered

    def add_hessian(self, x: Array, filter: str, target: BlockMatrix) -> int:
        """Add the Hessians of `matrices`; return the number of filtered points."""
        nodes, matrices, filtered = self.matrices(x, filter)
        target.add_couplings(nodes, matrices)
        return filtered

    def node_pairs(self, x: Array) -> Array:
        """Return the pairs of global nodes of facets that may touch, (n, 2).

        The array object stays the same until another pair of facets touches.
        """
        keys = self._keys(self.touching(x).point)
        if self._pairs is None or not np.isin(keys, self._known).all():
            self._known = np.union1d(self._known, keys)
            facets = np.divmod(self._known, len(self.side))
            a, b = (self._surface.nodes[self.side.nodes[facet]] for facet in facets)
            both = np.stack(np.broadcast_arrays(a[:, :, None], b[:, None]), axis=-1).reshape(-1, 2)
            self._pairs = np.unique(np.concatenate([both, both[:, ::-1]]), axis=0)
        return self._pairs

    def row(self, x: Array) -> dict[str, Any]:
        """Return `ContactPair.row`, and ``stiffness``, the present one [Pa/m]. Collective."""
        return super().row(x) | {"stiffness": float(self.law.stiffness[0]) / _SHARE}

    @property
    def own_points(self) -> Array:
        """The points of facets whose cells this rank owns, (n,) int."""
        numbers = np.arange(len(self.size)).reshape(self.side.weights.shape)
        return numbers[self.side.own].ravel()

    def history(self) -> tuple[Array, Array]:
        """Return positions of `own_points` (n, 3) [m], their multipliers and factors, (n, 2).

        The positions are reference ones, moved a little into the body.
        """
        X, own = self._surface.X, self.own_points
        points = self.points(X) - _INSIDE * self.size[:, None] * self.normals(X)
        return points[own], np.hstack(self.law.history())[own]

    def set_history(self, values: Array) -> None:
        """Set the kept multipliers and factors, (n, 2), as in `history`. Collective."""
        kept, comm = np.zeros_like(self.law.kept), self._surface.comm
        kept[self.own_points] = values[:, 0]
        # Each point has one owner.
        self.law.set_history(comm.allreduce(kept), values[:, 1], comm)

    def _find(self, x: Array, points: Array, normals: Array) -> tuple[Array, Array]:
        """Return the facets that points may touch, and where: see `FacetsInReach`.

        ``points`` are on all facets, in their order, equally many on each.
        """
        split = len(points) // len(self.side) * self._num_first
        parts = zip(self._closest, (slice(split), slice(split, None)), strict=True)
        first, second = (one.find(x, points[i], normals[i], self._reach) for one, i in parts)
        facet = np.where(first.facet >= 0, first.facet + self._num_first, -1)
        both = np.concatenate([facet, second.facet]), np.concatenate([first.start, second.start])
        return both

    def _measure(self, x: Array, which: Array) -> Gaps:
        facets, starts = self._facet[which], self._start[which]
        return measure_gaps(
            self._surface.shape, self.side, x, self.points(x)[which], facets, starts
        )

    def _moved(self, x: Array) -> float:
        """Return a bound of the change of any gap since the last search [m]."""
        moved = np.linalg.norm(x - self._searched, axis=1).max(initial=0.0)
        return 2 * _SPREAD * float(moved)

    def _at_start(self, which: Array) -> tuple[Gaps, Array]:
        """Return the gaps of points at the step's start, and their facets then.

        A point without one gets its present facet, with a gap > 0.
        """
        x, facets, starts = self._before
        has = facets[which] >= 0
        facet = np.where(has, facets[which], self._facet[which])
        start = np.where(has[:, None], starts[which], self._start[which])
        points = self.points(x)[which]
        gaps = measure_gaps(self._surface.shape, self.side, x, points, facet, start)
        gap = np.where(has, gaps.gap, np.maximum(gaps.gap, _OPEN * self.size[which]))
        return gaps._replace(gap=gap), facet

    def _mean_turn(self, x: Array) -> Array:
        """Return what the mean derivatives of the gaps add to `gradient`, (m, 3) [N].

        `mean_derivative` gets the displacements of a point's nodes minus their mean, so that the
        forces sum to zero.
        """
        at, found = self.touching(x), np.zeros_like(x)
        before, facet = self._at_start(at.point)
        basis, nodes = self._basis(at), self._nodes(at)
        nodes = np.concatenate([nodes, self.side.nodes[facet]], axis=1)
        k = basis.shape[1]
        old, new = gap_derivative(before, basis), gap_derivative(at.gaps, basis)
        has = self._before[1][at.point] >= 0
        old = np.where(has[:, None, None], old, new)
        none = np.zeros_like(new[:, k:])
        new = np.concatenate([new, none], axis=1)
        mean = (np.concatenate([old[:, :k], none, old[:, k:]], axis=1) + new) / 2
        way = (x - self._before[0])[nodes]
        way -= way.mean(axis=1, keepdims=True)
        start, end = (np.minimum(gap, self._reach) for gap in (before.gap, at.gaps.gap))
        flat, size = (len(nodes), 3 * nodes.shape[1]), self.size[at.point]
        mean = mean_derivative(mean.reshape(flat), end - start, way.reshape(flat), size)
        forces = mean.reshape(way.shape) - new
        forces *= (-self.law.weights[at.point] * at.pressure)[:, None, None]
        np.add.at(found, nodes, forces)
        return found

    def deepest(self, x: Array, search: bool) -> DeepestPoint:
        """Return the deepest point of either surface, among quadrature points and grid points.

        Each facet has one grid: ``search`` has no effect (see `ContactPair.deepest`).
        """
        at, shape, side = self.touching(x), self._surface.shape, self.side
        basis, derivatives = shape.evaluate(facet_grid(shape.kind))
        grid = basis @ x[side.nodes]
        points = grid.reshape(-1, 3)
        facet, start = self._find(x, points, self.normals(x, derivatives))
        gaps, some = np.full(len(points), np.inf), np.flatnonzero(facet >= 0)
        gaps[some] = measure_gaps(shape, side, x, points[some], facet[some], start[some]).gap
        known = np.full(len(self.size), np.inf)
        known[at.point] = at.gaps.gap
        both = np.hstack([known.reshape(side.weights.shape), gaps.reshape(grid.shape[:2])])
        positions = np.concatenate([side.basis @ x[side.nodes], grid], axis=1)
        return DeepestPoint.among(both, side.sizes, positions)

    def _basis(self, at: Touching) -> Array:
        return np.asarray(self.side.basis[at.point % len(self.side.basis)])

    def _nodes(self, at: Touching) -> Array:
        """Return each point's nodes as rows of ``x``, (n, 2 k): own facet, then the other one."""
        own = self.side.nodes[at.point // len(self.side.basis)]
        return np.concatenate([own, self.side.nodes[at.facet]], axis=1)

    def _keys(self, points: Array) -> Array:
        """Return a number for the pair of own and touched facet of each point."""
        own = points // len(self.side.basis)
        return np.asarray(own * len(self.side) + self._facet[points])


class BodyContact(SurfaceContact, MeanForceTerm, CouplingTerm):
    r"""The energy of contact between pairs of surfaces. Collective.

    The quadrature points q of both surfaces have gaps :math:`g_q` to the other surface, with half
    of the stiffness k, so that the result does not depend on the order of the surfaces:

    .. math:: E = \sum_{s = 1}^{2} \sum_{q \in \Gamma_s} \frac{w_q}{k}
        \left(\langle \ell_q - \tfrac{k}{2} g_q \rangle^2 - \ell_q^2\right)

    with weights :math:`w_q` and multipliers :math:`\ell_q` (`ContactLaw`). During a solve each
    point has one facet of the other surface, the closest one at the start of the step. After a
    solve the search is repeated, and the step is solved again until the forces have settled.
    `fem_snh.contact.triangle_search` has the derivatives of the gap.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    regions : sequence of Region
        The materials, which the default stiffness depends on.
    pairs : sequence of BodyPair
        The surfaces.
    kinematics : Kinematics, optional
        Kinematics of the displacement.

    Attributes
    ----------
    surface : GatheredSurface
        The nodes of all surfaces, on every rank.
    pairs : list of SurfacePair
        The contact of each pair.

    Raises
    ------
    BadInput
        On every rank, if a surface has no facet on the boundary, or a pair has a common node.
    """

    name, gathered = "contact", True
    pairs: list[SurfacePair]

    def __init__(
        self,
        V: FunctionSpace,
        regions: Sequence[Region],
        pairs: Sequence[BodyPair],
        kinematics: Kinematics = SOLID,
    ) -> None:
        super().__init__(V, kinematics)
        comm, degree = V.mesh.comm, _QUADRATURE + 2 * _dolfinx.degree(V)
        surfaces = list[SurfaceQuadrature]()
        for pair in pairs:
            for facets in (pair.first, pair.second):
                surfaces.append(SurfaceQuadrature(V, facets, degree, kinematics.revolved))
                if not comm.allreduce(len(surfaces[-1])):
                    raise bad_value("contact.groups", pair.name, "two surfaces of the boundary")
        self.surface = GatheredSurface(V, surfaces)
        self.pairs = []
        for i, pair in enumerate(pairs):
            both, sides = surfaces[2 * i : 2 * i + 2], self.surface.sides[2 * i : 2 * i + 2]
            default = min(surface_mean(s, default_stiffness(s, regions)) for s in both)
            height = max(surface_mean(s, cell_heights(s)) for s in both)
            first, second = sides
            self.pairs.append(SurfacePair(pair, self.surface, (first, second), default, height))
        self._stale, self._stepped = True, False
        self._coupled: tuple[list[Array], Array] | None = None

    def set_load(self, load: float) -> None:
        """Search the facets at the next evaluation, unless `begin_step` has ever been called."""
        self._stale |= not self._stepped

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of nodes that the Hessian couples: see `CouplingTerm`. Collective."""
        x = self.configuration(u)
        parts = [pair.node_pairs(x) for pair in self.pairs]
        if self._coupled is None or any(map(lambda a, b: a is not b, parts, self._coupled[0])):
            self._coupled = parts, np.concatenate(parts)
        return self._coupled[1]

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset multipliers to the last accepted step's, and search the facets. Collective."""
        self._stepped, self._stale = True, True
        super().begin_step(u)

    def history(self) -> tuple[Array, Array]:
        """Return `SurfacePair.history` of all pairs with multipliers, one after the other."""
        found = [pair.history() for pair in self.pairs if pair.law.augmented]
        points = [np.empty((0, 3)), *(points for points, _ in found)]
        values = [np.empty((0, 2)), *(values for _, values in found)]
        return np.concatenate(points), np.concatenate(values)

    def set_history(self, values: Array) -> None:
        """Set the kept multipliers and factors, (n, 2), as in `history`. Collective."""
        first = 0
        for pair in self.pairs:
            if pair.law.augmented:
                last = first + len(pair.own_points)
                pair.set_history(values[first:last])
                first = last

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return positions of ``surface.nodes``, (m, 3) [m]; search if it is due. Collective."""
        x = self.surface.positions(super().configuration(u))
        if self._stale:
            self._stale = False
            for pair in self.pairs:
                pair.search(x)
        return x
