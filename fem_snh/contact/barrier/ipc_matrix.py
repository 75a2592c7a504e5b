"""Matrices of an embedded surface's points as 3x3 blocks between the nodes that carry them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix, identity, kron

from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.contact.surfaces.embedded_surface import EmbeddedSurface

Array = npt.NDArray[Any]


class Blocks(NamedTuple):
    """Blocks in the rows that this rank owns; nodes are rows of ``surface.support.nodes``.

    Attributes
    ----------
    rows, columns : (n,) int
        The nodes of each block.
    values : (n, 3, 3)
        The blocks [N/m].
    """

    rows: Array
    columns: Array
    values: Array


class SurfaceMatrix:
    """The rows of this rank of a surface's matrix, and a pattern that contains them.

    Parameters
    ----------
    surface : EmbeddedSurface
        The surface.

    Attributes
    ----------
    pairs : (n, 2) int64
        Global nodes of the pattern's blocks: see `BlockMatrix.couple`. It is the same array until
        `extend` adds some.
    """

    def __init__(self, surface: EmbeddedSurface) -> None:
        self._nodes, own = surface.support.nodes, surface.support.is_own
        shape = (len(surface.points), len(self._nodes))
        indptr = np.arange(shape[0] + 1) * surface.columns.shape[1]
        entries = (surface.weights.ravel(), surface.columns.ravel(), indptr)
        weights = csr_matrix(entries, shape=shape)
        self._own = np.flatnonzero(own)
        self._map = kron(weights, identity(3), format="csr")
        self._own_map = kron(weights[:, self._own].T, identity(3), format="csr")
        self._nodal_map = csr_matrix(weights.T)
        self._keys: Array = np.empty(0, np.int64)
        self.pairs: Array = np.empty((0, 2), np.int64)

    def nodal(self, values: Array) -> Array:
        """Return the forces at the nodes (m, 3) of forces at the points (n, 3)."""
        return np.asarray(self._nodal_map @ values)

    def blocks(self, matrix: Any) -> Blocks:
        """Return the blocks of a sparse matrix of the points, (3 n, 3 n)."""
        found = csr_matrix(self._own_map @ (matrix @ self._map)).tobsr((3, 3))
        rows = self._own[np.repeat(np.arange(len(self._own)), np.diff(found.indptr))]
        return Blocks(rows, found.indices, found.data)

    def contains(self, blocks: Blocks) -> bool:
        """Return whether the pattern has these blocks."""
        return bool(np.isin(self._key(blocks), self._keys, assume_unique=True).all())

    def replace(self, *patterns: Blocks) -> None:
        """Replace the pattern by the union of several."""
        self._keys = np.unique(np.concatenate([self._key(blocks) for blocks in patterns]))
        rows, columns = np.divmod(self._keys, len(self._nodes))
        self.pairs = np.stack([self._nodes[rows], self._nodes[columns]], axis=1)

    def add(self, blocks: Blocks, target: BlockMatrix) -> None:
        """Add blocks to a matrix, inside of `BlockMatrix.adding`."""
        rows, columns = self._nodes[blocks.rows], self._nodes[blocks.columns]
        target.add_couplings(rows[:, None], blocks.values, columns[:, None])

    def _key(self, blocks: Blocks) -> Array:
        return blocks.rows.astype(np.int64) * len(self._nodes) + blocks.columns
