"""Two surfaces that may touch, with the points of either one against the facets of the other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.contact.gaps import (
    ClosestFacets,
    Gaps,
    gap_derivative,
    gap_second_derivative,
    measure_gaps,
)
from fem_snh.contact.gathered_surface import GatheredSurface, Side
from fem_snh.contact.law import ContactLaw, mean_derivative
from fem_snh.contact.surface_contact import ContactPair
from fem_snh.contact.surface_quadrature import DeepestPoint, cross_tangents, facet_grid
from fem_snh.errors import bad_value
from fem_snh.kernels.cell_matrices import filter_matrices
from fem_snh.terms.settling import LaggedChange, relative

Array = npt.NDArray[Any]

#: Each point has settled on a facet when a new search changes no nodal force by more than this
#: fraction of the largest.
_SETTLED = 1e-4
#: After this many searches of a step a point keeps a facet whose closest point is outside of it by
#: less than _KEPT, in reference coordinates: a point at an edge between two facets of different
#: normals would change from one to the other and back for ever.
_FREE_SEARCHES, _KEPT = 3, 0.1
#: Reach of the search in the diagonal of the smaller surface: bodies may move by this in a step.
_REACH = 0.5
#: Points by which a checkpoint finds multipliers are inside of their body by this many facets, as
#: surfaces that touch have points at the same place.
_INSIDE = 1e-3
#: A point of a facet moves by at most this times the largest motion of the facet's nodes: the sum
#: of the absolute values of the shape functions, largest on triangles of degree 2.
_SPREAD = 5 / 3
#: Gap in sizes of a facet below which a point's facet is in the sparsity pattern before they touch.
_MARGIN = 0.5
#: Gap in sizes of a facet below which surfaces touch without a force: rounding.
_ZERO_GAP = 1e-10
#: Least gap at a step's start, in sizes of a facet, of a point that has no facet there.
_OPEN = 1e-6


class BodyPair(NamedTuple):
    """Two surfaces of the mesh that may touch.

    Attributes
    ----------
    name : str
        Name in run.json.
    first, second : (n,) int
        This rank's facets of each surface.
    stiffness : float or None
        Penalty stiffness [Pa/m]; None for the smaller one of the surfaces' mean defaults.
    augmented : bool
        Whether multipliers reduce the penetration below the tolerance.
    tolerance : float or None
        Largest penetration [m] with the augmented Lagrangian; None for the default.
    limits_force : bool
        With the default tolerance, whether the change of the force is limited, too. In time it need
        not be: what a step's force lacks, the next one has.
    """

    name: str
    first: Array
    second: Array
    stiffness: float | None = None
    augmented: bool = False
    tolerance: float | None = None
    limits_force: bool = True


class Touching(NamedTuple):
    """The n points that touch a facet.

    Attributes
    ----------
    point : (n,) int
        The points, numbered facet by facet.
    row : (n,) int
        Their rows in the pair's law.
    facet : (n,) int
        The facets of the other surface.
    gaps : Gaps
        Their gaps.
    energy, pressure, stiffness : (n,)
        What `ContactLaw.response` returns.
    """

    point: Array
    row: Array
    facet: Array
    gaps: Gaps
    energy: Array
    pressure: Array
    stiffness: Array


class SurfacePass:
    r"""The points of one surface with their gaps to the other one, and derivatives of `ContactLaw`.

    Every rank evaluates all points.

    Parameters
    ----------
    surface : GatheredSurface
        The nodes.
    own, other : Side
        The surface whose quadrature points are used, and the one whose facets they touch.
    law : ContactLaw
        The law of the points of both passes.
    first : int
        Row in the law of this pass's first point.
    reach : float
        Largest distance of a point from its facet [m].

    Attributes
    ----------
    averages : bool
        Whether forces are means over a step, in place of the present ones: see `SurfacePair`.
    """

    averages = False

    def __init__(
        self,
        surface: GatheredSurface,
        own: Side,
        other: Side,
        law: ContactLaw,
        first: int,
        reach: float,
    ) -> None:
        self.surface, self.own, self.other, self.law = surface, own, other, law
        self._reach, self._count = reach, own.weights.size
        self._rows = np.arange(first, first + self._count)
        self.size = own.mean_size
        self._closest = ClosestFacets(surface.shape, other)
        self._facet: Array = np.full(self._count, -1)
        self._start: Array = np.zeros((0, 2))
        self._evaluated: tuple[Array, tuple[Any, ...], Touching] | None = None

    def begin_step(self, x: Array) -> None:
        """Begin a step at positions of the nodes, whose facets were searched there."""
        self._before = x.copy(), self._facet.copy(), self._start.copy()
        self._evaluated = None

    def search(self, x: Array, keep: float | None = None) -> None:
        """Choose the facet of each point.

        Parameters
        ----------
        x : (m, 3)
            Positions of the nodes [m].
        keep : float, optional
            A point keeps the facet that it has while its closest point is outside of it by less
            than this, in reference coordinates. Default: all points get the closest facet.
        """
        points = self.points(x)
        facet, start = self._closest.find(x, points, self.normals(x), self._reach)
        if keep is not None:
            other = np.flatnonzero((self._facet >= 0) & (facet != self._facet))
            near = other[self._measure(x, other).outside < keep]
            facet[near], start[near] = self._facet[near], self._start[near]
        self._facet, self._start = facet, start
        self._searched, self._evaluated = x, None
        self._gap = np.full(len(points), np.inf)
        some = np.flatnonzero(facet >= 0)
        self._gap[some] = self._measure(x, some).gap
        near = some[self._gap[some] < _MARGIN * self.size]
        self._known = self._keys(near)
        self._pairs: Array | None = None

    def has_lost(self, before: Touching) -> bool:
        """Return whether points that touched before a search have no facet any more."""
        return bool((self._facet[before.point[before.pressure > 0]] < 0).any())

    def points(self, x: Array) -> Array:
        """Return the positions of the quadrature points [m], (points, 3)."""
        return np.asarray((self.own.basis @ x[self.own.nodes]).reshape(-1, 3))

    def normals(self, x: Array, derivatives: Array | None = None) -> Array:
        """Return the outward unit normals of the own surface at the points, (points, 3).

        ``derivatives`` (n, k, d) are those of the shape functions at other points of a facet.
        """
        nodes = x[self.own.nodes]
        table = self.own.derivatives if derivatives is None else derivatives
        tangents = np.einsum("fki,pka->fpia", nodes, table, optimize=True)
        normals = cross_tangents(tangents)
        normals *= self.own.outward[:, None, None]
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        return normals.reshape(-1, 3)

    @property
    def own_rows(self) -> Array:
        """The rows in the law of facets whose cells this rank owns, (n,) int."""
        return self._rows.reshape(self.own.weights.shape)[self.own.own].ravel()

    def points_inside(self) -> Array:
        """Return the points of these facets, moved a little into the body, (n, 3) [m]."""
        X = self.surface.X
        points = self.points(X) - _INSIDE * self.size * self.normals(X)
        return points.reshape(*self.own.weights.shape, 3)[self.own.own].reshape(-1, 3)

    def touching(self, x: Array) -> Touching:
        """Return the points that touch their facets."""
        version = self.law.version, self.averages
        if self._evaluated and self._evaluated[1] == version:
            if np.array_equal(x, self._evaluated[0]):
                return self._evaluated[2]
        zero, reach = _ZERO_GAP * self.size, self._moved(x)
        if self.averages:
            reach = max(reach, self._moved(self._before[0]))
        close = (self._gap <= reach + zero) | (self.law.multipliers[self._rows] > 0)
        some = np.flatnonzero(close & (self._facet >= 0))
        gaps, rows = self._measure(x, some), self._rows[some]
        gap, start = gaps.gap, None
        if self.averages and not self.law.augmented:
            # Points far outside of their facets have infinite gaps.
            ends = self._at_start(some)[0].gap, gap
            start, gap = (np.minimum(end, self._reach) for end in ends)
        response = self.law.response(rows, gap, start)
        which = response.pressure > 0
        if start is None:
            which |= gap <= zero
        chosen = Gaps(*(values[which] for values in gaps))
        columns = (column[which] for column in response)
        found = Touching(some[which], rows[which], self._facet[some[which]], chosen, *columns)
        self._evaluated = x, version, found
        return found

    def turn(self, x: Array) -> Array:
        """Return what the mean derivatives of the gaps add to `gradient` [N], (m, 3).

        The ways of `mean_derivative` are those of a point's nodes less their mean: without it the
        forces had a sum.
        """
        at, found = self.touching(x), np.zeros_like(x)
        before, facet = self._at_start(at.point)
        basis, own = self._basis(at), self.own.nodes[at.point // len(self.own.basis)]
        k, others = own.shape[1], self.other.nodes
        nodes = np.concatenate([own, others[at.facet], others[facet]], axis=1)
        old, new = gap_derivative(before, basis), gap_derivative(at.gaps, basis)
        has = self._before[1][at.point] >= 0
        old = np.where(has[:, None, None], old, new)
        none = np.zeros_like(new[:, k:])
        new = np.concatenate([new, none], axis=1)
        mean = (np.concatenate([old[:, :k], none, old[:, k:]], axis=1) + new) / 2
        way = (x - self._before[0])[nodes]
        way -= way.mean(axis=1, keepdims=True)
        start, end = (np.minimum(gap, self._reach) for gap in (before.gap, at.gaps.gap))
        flat = (len(nodes), 3 * nodes.shape[1])
        mean = mean_derivative(mean.reshape(flat), end - start, way.reshape(flat), self.size)
        forces = mean.reshape(way.shape) - new
        forces *= (-self.law.weights[at.row] * at.pressure)[:, None, None]
        np.add.at(found, nodes, forces)
        return found

    def _moved(self, x: Array) -> float:
        """Return by how much gaps may have changed since the search, as both surfaces move [m]."""
        moved = np.linalg.norm(x - self._searched, axis=1).max(initial=0.0)
        return 2 * _SPREAD * float(moved)

    def _at_start(self, which: Array) -> tuple[Gaps, Array]:
        """Return the gaps of points at the step's start, and their facets there.

        A point without a facet has the present one, and is open.
        """
        x, facets, starts = self._before
        has = facets[which] >= 0
        facet = np.where(has, facets[which], self._facet[which])
        start = np.where(has[:, None], starts[which], self._start[which])
        gaps = measure_gaps(self.surface.shape, self.other, x, self.points(x)[which], facet, start)
        gap = np.where(has, gaps.gap, np.maximum(gaps.gap, _OPEN * self.size))
        return gaps._replace(gap=gap), facet

    def deepest(self, x: Array) -> DeepestPoint:
        """Return the deepest point of the own surface in the other one."""
        shape, at = self.surface.shape, self.touching(x)
        basis, derivatives = shape.evaluate(facet_grid(shape.kind))
        grid = basis @ x[self.own.nodes]
        points = grid.reshape(-1, 3)
        normals = self.normals(x, derivatives)
        facet, start = self._closest.find(x, points, normals, self._reach)
        gaps, some = np.full(len(points), np.inf), np.flatnonzero(facet >= 0)
        gaps[some] = measure_gaps(shape, self.other, x, points[some], facet[some], start[some]).gap
        known = np.full(self._count, np.inf)
        known[at.point] = at.gaps.gap
        both = np.hstack([known.reshape(self.own.weights.shape), gaps.reshape(grid.shape[:2])])
        positions = np.concatenate([self.own.basis @ x[self.own.nodes], grid], axis=1)
        return DeepestPoint.among(both, self.own.sizes, positions)

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative by the nodes [N], (m, 3)."""
        at = self.touching(x)
        forces = gap_derivative(at.gaps, self._basis(at))
        forces *= (-self.law.weights[at.row] * at.pressure)[:, None, None]
        nodes, count = self._nodes(at).ravel(), len(x)
        columns = [np.bincount(nodes, forces[..., i].ravel(), count) for i in range(3)]
        return np.stack(columns, axis=1)

    def matrices(self, x: Array, filter: str) -> tuple[Array, Array, int]:
        """Return global nodes (n, k), filtered matrices (n, c k, c k), and how many were filtered.

        c is the number of the displacement's components.

        Only those of which this rank owns a row are returned, summed over the points of a facet
        that touch the same facet.
        """
        at = self.touching(x)
        mine = self.surface.is_own[self._nodes(at)].any(axis=1)
        gaps = Gaps(*(values[mine] for values in at.gaps))
        rows = at.row[mine]
        parts = (column[mine] for column in (at.energy, at.pressure, at.stiffness))
        at = Touching(at.point[mine], rows, at.facet[mine], gaps, *parts)
        basis, nodes = self._basis(at), self._nodes(at)
        dg = gap_derivative(gaps, basis).reshape(len(rows), 3 * nodes.shape[1])
        Q, C = gap_second_derivative(gaps, basis)
        # The eigenvalues of Q C Q^T are those of R C R^T, and zeros.
        Q, R = np.linalg.qr(Q)
        curved = R @ (-at.pressure[:, None, None] * C) @ np.swapaxes(R, 1, 2)
        curved, filtered = filter_matrices(curved, filter)
        found = at.stiffness[:, None, None] * dg[:, :, None] * dg[:, None]
        found += Q @ curved @ np.swapaxes(Q, 1, 2)
        found *= self.law.weights[rows, None, None]
        _, first, which = np.unique(self._key(at), return_index=True, return_inverse=True)
        order = np.argsort(which.ravel(), kind="stable")
        starts = np.searchsorted(which.ravel()[order], np.arange(len(first)))
        found = np.add.reduceat(found[order], starts) if len(first) else found
        k, c = nodes.shape[1], self.surface.components
        found = found.reshape(-1, k, 3, k, 3)[:, :, :c, :, :c].reshape(-1, c * k, c * k)
        return self.surface.nodes[nodes[first]], found, filtered

    def pairs(self, x: Array) -> Array:
        """Return the pairs of global nodes of facets that may touch, (n, 2).

        The same array until a facet outside of it is touched.
        """
        at = self.touching(x)
        keys = self._key(at)
        if self._pairs is None or not np.isin(keys, self._known).all():
            self._known = np.union1d(self._known, keys)
            own, other = np.divmod(self._known, max(len(self.other), 1))
            a = self.surface.nodes[self.own.nodes[own]]
            b = self.surface.nodes[self.other.nodes[other]]
            both = np.stack(np.broadcast_arrays(a[:, :, None], b[:, None]), axis=-1).reshape(-1, 2)
            self._pairs = np.unique(np.concatenate([both, both[:, ::-1]]), axis=0)
        return self._pairs

    def _measure(self, x: Array, which: Array) -> Gaps:
        shape, points = self.surface.shape, self.points(x)[which]
        return measure_gaps(shape, self.other, x, points, self._facet[which], self._start[which])

    def _basis(self, at: Touching) -> Array:
        return np.asarray(self.own.basis[at.point % len(self.own.basis)])

    def _nodes(self, at: Touching) -> Array:
        """Return the nodes of both facets of each point, as rows of the surface's nodes."""
        own = self.own.nodes[at.point // len(self.own.basis)]
        return np.concatenate([own, self.other.nodes[at.facet]], axis=1)

    def _key(self, at: Touching) -> Array:
        return np.asarray(at.point // len(self.own.basis) * len(self.other) + at.facet)

    def _keys(self, points: Array) -> Array:
        """Return numbers of the pairs of facets of some points, sorted."""
        own = points // len(self.own.basis)
        return np.unique(own * len(self.other) + self._facet[points])


class SurfacePair(ContactPair):
    """Contact of two surfaces in two passes, each with half of the stiffness.

    All ranks have the same, and positions of the nodes ``x`` are (m, 3) [m].

    In time, Newmark's method has contact as the mean over a step: with `mean_pressure` at the gaps
    of the step's start and end, each to the facet that is the closest one then, and with their mean
    derivatives (`SurfacePass.turn`) the forces do the work that the energy of contact loses. The
    part of the derivatives that is not that of the end is lagged.

    Parameters
    ----------
    pair : BodyPair
        Name and method.
    surface : GatheredSurface
        The nodes.
    sides : tuple of two Side
        The surfaces.
    default : float
        The default stiffness [Pa/m].
    height : float
        The height of the cells at the surfaces [m].

    Attributes
    ----------
    passes : tuple of two SurfacePass
        The points of the first surface, and those of the second.

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
        boxes = (np.ptp(surface.X[side.nodes.ravel()], axis=0) for side in sides)
        reach = _REACH * min(float(np.linalg.norm(box)) for box in boxes)
        weights = np.concatenate([side.weights.ravel() for side in sides])
        law = ContactLaw.of(pair, "contact", weights, np.full(1, default), height, share=0.5)
        super().__init__(pair.name, law)
        self.stiffness = default if pair.stiffness is None else pair.stiffness
        self._surface, self._searches = surface, 0
        self.passes = (
            SurfacePass(surface, first, second, law, 0, reach),
            SurfacePass(surface, second, first, law, first.weights.size, reach),
        )

    def energy(self, x: Array) -> float:
        """Return the energy [J]."""
        rows, _, _, energies = self._touching(x)
        energy = self.law.energy(rows, energies)
        if self.mean_weight is not None:
            energy += float((self._turn * (x - self._before)).sum())
        return self.weight * energy

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative by the nodes [N], (m, 3)."""
        first, second = self.passes
        found = first.gradient(x) + second.gradient(x)
        return found if self.mean_weight is None else self.weight * (found + self._turn)

    def weight_mean_forces(self, weight: float | None) -> None:
        """Set the weight of a step's mean forces."""
        super().weight_mean_forces(weight)
        for one in self.passes:
            one.averages = weight is not None

    def matrices(self, x: Array, filter: str) -> Iterator[tuple[Array, Array, int]]:
        """Yield what `SurfacePass.matrices` returns for either pass, weighted."""
        for one in self.passes:
            nodes, matrices, filtered = one.matrices(x, filter)
            yield nodes, self.weight * matrices, filtered

    @property
    def first(self) -> Array:
        """The first surface's nodes, as rows of ``GatheredSurface.X``, (n,) int."""
        return np.unique(self.passes[0].own.nodes)

    def nodal_forces(self, x: Array) -> Array:
        """Return the forces of the second surface on the first one's nodes [N], (m, 3)."""
        forces = np.zeros_like(x)
        forces[self.first] = -self.gradient(x)[self.first]
        return forces

    def force_derivative(self, component: int, x: Array) -> Array:
        """Return the derivative of a component of `force` by own nodes [N/m], (m, c)."""
        c, translation = self._surface.components, np.zeros((len(x), self._surface.components))
        translation[self.first, component] = 1.0
        found = np.zeros_like(translation)
        for nodes, matrices, _ in self.matrices(x, "exact"):
            rows = np.searchsorted(self._surface.nodes, nodes)
            products = matrices @ translation[rows].reshape(len(rows), -1, 1)
            np.add.at(found, rows, -products.reshape(*rows.shape, c))
        return found

    def row(self, x: Array) -> dict[str, Any]:
        """Return the pair's row of run.json.

        ``force`` [N], which the second surface exerts on the first; ``contacts``, the number of
        points that touch; ``penetration`` [m], their largest; ``deepest`` and ``deepest_at`` of
        `DeepestPoint.row`; ``stiffness`` [Pa/m].
        """
        _, gap, pressure = self.acting(x)
        penetration = max(0.0, float(-gap.min(initial=0.0)))  # max: not -0.0
        deepest = DeepestPoint.deepest(one.deepest(x) for one in self.passes)
        return {
            "force": self.nodal_forces(x).sum(axis=0).tolist(),
            "contacts": int((pressure > 0).sum()),
            "penetration": penetration,
            **deepest.row(penetration),
            "stiffness": self.stiffness,
        }

    def begin_step(self, x: Array) -> None:
        """Reset the multipliers to those of the last step, which ends at positions ``x``."""
        self.law.begin_step()
        self._searches, self._before = 0, x.copy()
        self._turn = np.zeros_like(x)
        for one in self.passes:
            one.begin_step(x)

    def settle(self, x: Array) -> list[LaggedChange]:
        """Search again and update the multipliers; return the changes."""
        before, keep = self.gradient(x), _KEPT if self._searches >= _FREE_SEARCHES else None
        touched = [one.touching(x) for one in self.passes]
        self._searches += 1
        for one in self.passes:
            one.search(x, keep)
        if self.mean_weight is not None:
            self._turn = self.passes[0].turn(x) + self.passes[1].turn(x)
        after = self.gradient(x)
        largest = max(np.abs(before).max(initial=0.0), np.abs(after).max(initial=0.0))
        change = float(np.abs(after - before).max(initial=0.0))
        what = f"contact '{self.name}': the change of forces by another search"
        slid_off = any(map(SurfacePass.has_lost, self.passes, touched))
        changed = LaggedChange(relative(change, largest, _SETTLED), what, slid_off)
        return [changed, *self.law.settle(*self.acting(x))]

    def history(self) -> tuple[Array, Array]:
        """Return points of this rank's facets (n, 3), and multipliers and factors there, (n, 2)."""
        points = np.concatenate([one.points_inside() for one in self.passes])
        return points, np.hstack(self.law.history())[self.own_rows]

    def set_history(self, values: Array) -> None:
        """Set what is kept, (n, 2), in the order of `history`. Collective."""
        kept, comm = np.zeros_like(self.law.kept), self._surface.comm
        kept[self.own_rows] = values[:, 0]
        # Each point has one owner.
        self.law.set_history(comm.allreduce(kept), values[:, 1], comm)

    @property
    def own_rows(self) -> Array:
        """The rows of the law that this rank keeps in a checkpoint, (n,) int."""
        return np.concatenate([one.own_rows for one in self.passes])

    def acting(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the rows, gaps and pressures of the points of both passes that touch."""
        return self._touching(x)[:3]

    def _touching(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return what `acting` does, and the energies."""
        found = [one.touching(x) for one in self.passes]
        parts = [(at.row, at.gaps.gap, at.pressure, at.energy) for at in found]
        rows, gap, pressure, energy = map(np.concatenate, zip(*parts, strict=True))
        return rows, gap, pressure, energy
