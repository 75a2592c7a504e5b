"""Contact of the quadrature points of one surface with the facets of another: one of two passes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.contact.deepest_point import DeepestPoint, facet_grid
from fem_snh.contact.gaps import (
    ClosestFacets,
    Gaps,
    gap_derivative,
    gap_second_derivative,
    measure_gaps,
)
from fem_snh.contact.gathered_surface import GatheredSurface, Side

Array = npt.NDArray[Any]

#: A point of a facet moves by at most this times the largest motion of the facet's nodes: the sum
#: of the absolute values of the shape functions, largest on triangles of degree 2.
_SPREAD = 5 / 3
#: Gap in sizes of a facet below which a point's facet is in the sparsity pattern before they touch.
_MARGIN = 0.5
#: Gap in sizes of a facet below which surfaces touch without a force: rounding.
_ZERO_GAP = 1e-10


class Touching(NamedTuple):
    """The n points that touch a facet.

    Attributes
    ----------
    point : (n,) int
        The points, numbered facet by facet.
    facet : (n,) int
        The facets of the other surface.
    gaps : Gaps
        Their gaps.
    pressure : (n,)
        Contact force per reference area [Pa].
    """

    point: Array
    facet: Array
    gaps: Gaps
    pressure: Array


class SurfacePass:
    r"""The energy of the points of one surface, with gaps to the other one.

    .. math:: E = \sum_q \frac{w_q}{2 k} \left(p^2 - \ell^2\right), \qquad
        p = \langle \ell - k g \rangle

    Every rank evaluates all points.

    Parameters
    ----------
    surface : GatheredSurface
        The nodes.
    own, other : Side
        The surface whose quadrature points are used, and the one whose facets they touch.
    stiffness : float
        The stiffness k of this pass [Pa/m].
    reach : float
        Largest distance of a point from its facet [m].

    Attributes
    ----------
    multipliers : (points,)
        The multipliers l [Pa], zero with a penalty.
    """

    def __init__(
        self, surface: GatheredSurface, own: Side, other: Side, stiffness: float, reach: float
    ) -> None:
        self.surface, self.own, self.other = surface, own, other
        self.stiffness, self._reach = stiffness, reach
        self.weights = own.weights.ravel()
        self.size = float(np.sqrt(own.weights.sum(axis=1).mean()))
        self.multipliers = np.zeros(len(self.weights))
        self._closest = ClosestFacets(surface.shape, other)
        self._facet: Array = np.full(len(self.weights), -1)
        self._start: Array = np.zeros((0, 2))
        self._evaluated: tuple[Array, Touching] | None = None

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

    def points(self, x: Array) -> Array:
        """Return the positions of the quadrature points [m], (points, 3)."""
        return np.asarray((self.own.basis @ x[self.own.nodes]).reshape(-1, 3))

    def normals(self, x: Array, derivatives: Array | None = None) -> Array:
        """Return the outward unit normals of the own surface at the points, (points, 3).

        ``derivatives`` (n, k, 2) are those of the shape functions at other points of a facet.
        """
        nodes = x[self.own.nodes]
        table = self.own.derivatives if derivatives is None else derivatives
        tangents = np.einsum("fki,pka->fpia", nodes, table, optimize=True)
        normals = np.cross(tangents[..., 0], tangents[..., 1])
        normals *= self.own.outward[:, None, None]
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        return normals.reshape(-1, 3)

    @property
    def own_points(self) -> Array:
        """The points of the facets whose cells this rank owns, (n,) int."""
        count = len(self.own.basis)
        return np.asarray((self.own.own[:, None] * count + np.arange(count)).ravel())

    def set_multipliers(self, x: Array, stiffness: float = 0.0) -> None:
        """Set multipliers that exert the present pressures with this stiffness.

        Those of stiffness 0 are the pressures, as augmentation sets them (Wriggers 2006, 6.3.4).
        """
        at = self.touching(x)
        pressure = np.where(at.pressure > 0, at.pressure + stiffness * at.gaps.gap, 0.0)
        self.multipliers[:] = 0.0
        self.multipliers[at.point] = pressure
        self._evaluated = None

    def augmentation(self, x: Array) -> tuple[float, float]:
        """Return the sum of the pressures' changes by `set_multipliers`, and of pressures [N]."""
        at, change = self.touching(x), self.multipliers.copy()
        change[at.point] -= at.pressure
        return float(self.weights @ np.abs(change)), float(self.weights[at.point] @ at.pressure)

    def largest_gap(self, x: Array) -> float:
        """Return the largest distance between points that exert a force and their facets [m]."""
        at = self.touching(x)
        return float(np.abs(at.gaps.gap[at.pressure > 0]).max(initial=0.0))

    def touching(self, x: Array) -> Touching:
        """Return the points that touch their facets."""
        if self._evaluated and np.array_equal(x, self._evaluated[0]):
            return self._evaluated[1]
        # Both surfaces move towards each other by at most this.
        moved = 2 * _SPREAD * float(np.linalg.norm(x - self._searched, axis=1).max(initial=0.0))
        zero = _ZERO_GAP * self.size
        close = (self._gap <= moved + zero) | (self.multipliers > 0)
        some = np.flatnonzero(close & (self._facet >= 0))
        gaps = self._measure(x, some)
        pressure = np.maximum(self.multipliers[some] - self.stiffness * gaps.gap, 0.0)
        which = (pressure > 0) | (gaps.gap <= zero)
        chosen = Gaps(*(values[which] for values in gaps))
        some = some[which]
        found = Touching(some, self._facet[some], chosen, pressure[which])
        self._evaluated = x, found
        return found

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
        known = np.full(len(self.weights), np.inf)
        known[at.point] = at.gaps.gap
        both = np.hstack([known.reshape(self.own.weights.shape), gaps.reshape(grid.shape[:2])])
        positions = np.concatenate([self.own.basis @ x[self.own.nodes], grid], axis=1)
        return DeepestPoint.among(both, self.own.weights.sum(axis=1), positions)

    def energy(self, x: Array) -> float:
        """Return the energy of all points [J]."""
        at = self.touching(x)
        stored = self.weights[at.point] @ at.pressure**2 - self.weights @ self.multipliers**2
        return float(stored) / (2 * self.stiffness)

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative by the nodes [N], (m, 3)."""
        at = self.touching(x)
        forces = gap_derivative(at.gaps, self._basis(at))
        forces *= (-self.weights[at.point] * at.pressure)[:, None, None]
        nodes, count = self._nodes(at).ravel(), len(x)
        columns = [np.bincount(nodes, forces[..., i].ravel(), count) for i in range(3)]
        return np.stack(columns, axis=1)

    def matrices(self, x: Array, filter: str) -> tuple[Array, Array, int]:
        """Return global nodes (n, k), filtered matrices (n, 3 k, 3 k), and how many were filtered.

        Only those of which this rank owns a row are returned, summed over the points of a facet
        that touch the same facet.
        """
        at = self.touching(x)
        mine = self.surface.is_own[self._nodes(at)].any(axis=1)
        gaps = Gaps(*(values[mine] for values in at.gaps))
        at = Touching(at.point[mine], at.facet[mine], gaps, at.pressure[mine])
        basis, weights, nodes = self._basis(at), self.weights[at.point], self._nodes(at)
        dg = gap_derivative(gaps, basis).reshape(len(weights), 3 * nodes.shape[1])
        Q, C = gap_second_derivative(gaps, basis)
        Q, C, filtered = _filter(Q, -at.pressure[:, None, None] * C, filter)
        found = self.stiffness * dg[:, :, None] * dg[:, None] + Q @ C @ np.swapaxes(Q, 1, 2)
        found *= weights[:, None, None]
        _, first, which = np.unique(self._key(at), return_index=True, return_inverse=True)
        order = np.argsort(which.ravel(), kind="stable")
        starts = np.searchsorted(which.ravel()[order], np.arange(len(first)))
        found = np.add.reduceat(found[order], starts) if len(first) else found
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


def _filter(Q: Array, C: Array, filter: str) -> tuple[Array, Array, int]:
    """Filter the eigenvalues of products Q C Q^T; return factors of the same form and a count."""
    if filter == "exact" or not len(Q):
        return Q, C, 0
    Q, R = np.linalg.qr(Q)
    values, vectors = np.linalg.eigh(R @ C @ np.swapaxes(R, 1, 2))
    changed = np.abs(values) if filter == "abs" else np.maximum(values, 0.0)
    # Products of rank 4 have further eigenvalues, which are zero but for rounding.
    negative = values[:, 0] < -1e-12 * np.abs(values).max(axis=1)
    C = (vectors * changed[:, None]) @ np.swapaxes(vectors, 1, 2)
    return Q, C, int(negative.sum())
