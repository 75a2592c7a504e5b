"""Blocks of a matrix between nodes that share no cell, as contact between two surfaces adds.

The cells of a mesh give a sparsity pattern once and for all. Which nodes touch each other changes
with the displacement, so `fem_snh.assembly.assembled_matrix.BlockMatrix.couple` extends the pattern
of the cells by pairs of nodes, when a pair is needed that it lacks. A pattern that once had a pair
keeps it for a while: two facets that touch and part in turn do not change the pattern each time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.matrix_layout import MixedDofMap

Array = npt.NDArray[Any]

#: Old pairs are kept while there are at most this many times as many of them as of new ones: their
#: zeros cost the linear solver time, a new pattern costs that of about one Newton step.
_KEPT_PAIRS = 2


class Couplings:
    """The coupled pairs of displacement nodes, and the matrices that are added to them. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns, the displacement's before others.
    constrained_dofs : (n,) int
        The constrained dofs that this rank owns, as offsets from its first one.

    Attributes
    ----------
    pairs : (n, 2) int64
        Row and column of each additional block of the rows that this rank owns, as global blocks.
    """

    def __init__(self, dof_map: MixedDofMap, constrained_dofs: Array) -> None:
        self._dof_map = dof_map
        self._num_blocks = dof_map.comm.allreduce(np.diff(dof_map.owned_range)[0])
        first = dof_map.comm.exscan(dof_map.num_owned_dofs) or 0
        self._own_dofs = (first, first + dof_map.num_owned_dofs)
        self._num_dofs = dof_map.comm.allreduce(dof_map.num_owned_dofs)
        self._fixed = np.concatenate(dof_map.comm.allgather(first + constrained_dofs))
        self._keys = np.empty(0, np.int64)
        self._eliminated = np.empty(0, np.int64)
        self._last: list[Array] = []
        self._added: list[tuple[Array, Array, Array]] = []

    @property
    def pairs(self) -> Array:
        keys = np.union1d(self._keys, self._eliminated) if len(self._eliminated) else self._keys
        return np.stack(np.divmod(keys, self._num_blocks), axis=1)

    def require(self, pairs: Sequence[Array]) -> bool:
        """Include pairs of nodes; return whether `pairs` changed on any rank. Collective.

        Parameters
        ----------
        pairs : sequence of (n, 2) int64
            See `BlockMatrix.couple`.
        """
        missing = False
        if [*map(id, pairs)] != [*map(id, self._last)]:
            blocks = self._dof_map.displacement_blocks(np.concatenate(pairs))
            first, last = self._dof_map.owned_range
            own = blocks[(blocks[:, 0] >= first) & (blocks[:, 0] < last)]
            keys = np.unique(own[:, 0] * self._num_blocks + own[:, 1])
            missing = not np.isin(keys, self._keys, assume_unique=True).all()
        changed = self._dof_map.comm.allreduce(missing, op=MPI.LOR)
        if missing:
            kept = self._keys if len(self._keys) <= _KEPT_PAIRS * len(keys) else keys[:0]
            self._keys = np.union1d(kept, keys)
        self._last = list(pairs)
        return bool(changed)

    def require_eliminated(self, blocks: Array) -> bool:
        """Include the pairs of a fold; return whether `pairs` changed on any rank. Collective.

        Parameters
        ----------
        blocks : (n, 2) int64
            See `fem_snh.assembly.elimination.Elimination.pairs`.
        """
        keys = np.unique(blocks[:, 0] * self._num_blocks + blocks[:, 1])
        missing = not np.isin(keys, self._eliminated, assume_unique=True).all()
        self._eliminated = np.union1d(keys, self._eliminated)
        return bool(self._dof_map.comm.allreduce(missing, op=MPI.LOR))

    def add(self, nodes: Array, matrices: Array, others: Array | None = None) -> None:
        """Keep matrices for `set_values`: see `BlockMatrix.add_couplings`. Not collective."""
        dofs, free = self._dofs(nodes)
        column_dofs, column_free = (dofs, free) if others is None else self._dofs(others)
        first, last = self._own_dofs
        row = (dofs >= first) & (dofs < last) & free
        which = row[:, :, None] & column_free[:, None, :]
        rows = np.broadcast_to(dofs[:, :, None], which.shape)[which]
        columns = np.broadcast_to(column_dofs[:, None, :], which.shape)[which]
        self._added.append((rows - first, columns, matrices[which]))

    def _dofs(self, nodes: Array) -> tuple[Array, Array]:
        """Return the global dofs (n, c k) of nodes (n, k), and which of them are free."""
        start, _ = self._dof_map.global_dofs(self._dof_map.displacement_blocks(nodes.ravel()))
        components = self._dof_map.components
        dofs = start[:, None] + np.arange(components)
        dofs = dofs.reshape(len(nodes), components * nodes.shape[1])
        return dofs, ~np.isin(dofs, self._fixed)

    def set_values(self, mat: PETSc.Mat) -> None:
        """Add what was given to `add` to the matrix, before it is assembled."""
        if not self._added:
            return
        rows, columns, values = (
            np.concatenate(column) for column in zip(*self._added, strict=True)
        )
        self._added = []
        from scipy.sparse import coo_matrix  # slow to import, and only contact adds couplings

        shape = (self._own_dofs[1] - self._own_dofs[0], self._num_dofs)
        # The conversion sums the values of one position.
        total = coo_matrix((values, (rows, columns)), shape=shape).tocsr()
        filled = np.flatnonzero(np.diff(total.indptr))
        indptr = np.append(total.indptr[filled], total.nnz)
        mat.setValuesIJV(
            indptr.astype(PETSc.IntType),
            total.indices.astype(PETSc.IntType),
            total.data,
            addv=PETSc.InsertMode.ADD,
            rowmap=(filled + self._own_dofs[0]).astype(PETSc.IntType),
        )
