"""Pairs of a sample and a target on a surface, and the energy of their springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix, diags

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class ContactPairs:
    r"""Springs between samples and targets, constant during a solve; the same on all ranks.

    With the gap :math:`g = n \cdot (x_s - x_t)`, the sample's position minus the target's along the
    target's outward normal, lagged, the energy is

    .. math:: E = \sum \tfrac{c}{2} \langle -g \rangle^2 .

    It is convex in the displacement, and its forces sum to zero, as the weights of a sample and of
    a target have the same sum. In two dimensions the surface has segments in place of triangles,
    and vectors have two components; the shapes below are those of three.

    Attributes
    ----------
    sample : (n,) int
        The sample of each pair, sorted; the samples are followed by the edges that cross others.
    target : (n,) int
        The triangle in which the target is.
    corners : (n, 6) int
        Points of the surface: of the sample's triangle, then of the target's.
    factors : (n, 6)
        Their weights in the sample's position minus the target's.
    normal : (n, 3)
        Outward unit normal of the surface at the target.
    stiffness : (n,)
        The springs' c [N/m].
    """

    sample: Array
    target: Array
    corners: Array
    factors: Array
    normal: Array
    stiffness: Array

    @classmethod
    def none(cls, dim: int) -> ContactPairs:
        """Return no pairs, in so many dimensions."""
        return cls(
            np.empty(0, int),
            np.empty(0, int),
            np.empty((0, 2 * dim), int),
            np.empty((0, 2 * dim)),
            np.empty((0, dim)),
            np.empty(0),
        )

    def __len__(self) -> int:
        return len(self.sample)

    def __getitem__(self, chosen: Array) -> ContactPairs:
        """Return some of the pairs."""
        return ContactPairs(
            self.sample[chosen],
            self.target[chosen],
            self.corners[chosen],
            self.factors[chosen],
            self.normal[chosen],
            self.stiffness[chosen],
        )

    def joined(self, other: ContactPairs) -> ContactPairs:
        """Return these pairs and others."""
        both = [np.concatenate(pair) for pair in zip(self._columns, other._columns, strict=True)]
        return ContactPairs(*both)[np.argsort(both[0], kind="stable")]

    def find(self, other: ContactPairs, x: Array, distance: float) -> Array:
        """Return for each pair the one of others with its sample and a target close to its own.

        Parameters
        ----------
        other : ContactPairs
            Other pairs.
        x : (points, 3)
            The positions of the surface's points [m].
        distance : float
            Largest distance of the targets [m].

        Returns
        -------
        (n,) int
            Indices of ``other``; -1 for none.
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
        """Return the positions (n, 3) of the samples and of their targets [m].

        ``x`` (points, 3) are those of the surface's points, deformed or in the reference
        configuration.
        """
        weighted, dim = self.factors[..., None] * x[self.corners], self.normal.shape[1]
        return weighted[:, :dim].sum(axis=1), -weighted[:, dim:].sum(axis=1)

    @property
    def _columns(self) -> tuple[Array, ...]:
        return self.sample, self.target, self.corners, self.factors, self.normal, self.stiffness

    def gaps(self, x: Array) -> Array:
        """Return the gaps [m] at the positions of the surface's points x (points, 3), (n,)."""
        apart = np.einsum("nk,nki->ni", self.factors, x[self.corners])
        return np.asarray(np.einsum("ni,ni->n", apart, self.normal))

    def energy(self, x: Array) -> float:
        """Return the energy [J]."""
        return float(self.stiffness @ np.minimum(self.gaps(x), 0.0) ** 2) / 2

    def forces(self, x: Array) -> Array:
        """Return the forces of the springs [N], positive in contact, (n,)."""
        return np.asarray(-self.stiffness * np.minimum(self.gaps(x), 0.0))

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative by the surface's points [N], (points, 3)."""
        vectors = -self.forces(x)[:, None] * self.normal
        values = self.factors[..., None] * vectors[:, None]
        index = self.corners.ravel()
        return np.stack(
            [np.bincount(index, column.ravel(), len(x)) for column in np.moveaxis(values, 2, 0)],
            axis=1,
        )

    def hessian(self, x: Array) -> csr_matrix:
        """Return the energy's Hessian by the surface's points [N/m], (3 points, 3 points)."""
        active = self[np.flatnonzero(self.gaps(x) < 0)]
        return _products(active.factors, active, active.normal, len(x))

    def pattern(self, num_points: int) -> csr_matrix:
        """Return a matrix without zeros at the blocks of all pairs, (3 points, 3 points)."""
        return _products(np.abs(self.factors), self, np.abs(self.normal), num_points)


def _products(factors: Array, pairs: ContactPairs, normal: Array, num_points: int) -> csr_matrix:
    """Return the sum of the outer products of the gaps' derivatives, times the stiffnesses."""
    values, dim = factors[..., None] * normal[:, None], normal.shape[1]
    columns = dim * pairs.corners[..., None] + np.arange(dim)
    indptr = np.arange(len(pairs) + 1) * 2 * dim**2
    shape = (len(pairs), dim * num_points)
    gaps = csr_matrix((values.ravel(), columns.ravel(), indptr), shape=shape)
    return csr_matrix(gaps.T @ (diags(pairs.stiffness) @ gaps))
