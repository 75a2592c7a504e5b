"""Blocks of a matrix between nodes that share no cell.

Contact (`fem_snh.terms.term.CouplingTerm`) and the elimination of rigid parts
(`fem_snh.assembly.elimination`) add these blocks. The pattern of the cells is constant, but the
nodes in contact change with the displacement. So
`fem_snh.assembly.assembled_matrix.BlockMatrix.couple` extends the pattern when it lacks a required
pair of nodes. Pairs that are no longer required stay for a while: facets that touch and separate in
turn do not change the pattern each time.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh.arrays import Array
from fem_snh.assembly.matrix_layout import MixedDofMap

#: When pairs are added, the former pairs are kept if their number is at most this factor times the
#: number of required pairs: zero blocks cost the linear solver time, and a new pattern costs about
#: the time of one Newton step.
_KEPT_PAIRS = 2


class Couplings:
    """The pairs of displacement nodes that share no cell, and values for their blocks. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns, displacements first.
    constrained_dofs : (n,) int
        The constrained dofs that this rank owns, as offsets from its first dof.

    Attributes
    ----------
    pairs : (n, 2) int64
        Global block row and block column of each additional block in the rows that this rank owns.
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
        """Add node pairs to `pairs`; return whether `pairs` changed on any rank. Collective.

        Parameters
        ----------
        pairs : sequence of (n, 2) int64
            See `BlockMatrix.couple`. The same array objects as in the last call are not examined.
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
        """Add an elimination's blocks to `pairs`; return whether any rank lacked one. Collective.

        Parameters
        ----------
        blocks : (n, 2) int64
            See `fem_snh.assembly.elimination.Elimination.pairs`. They stay in `pairs`.
        """
        keys = np.unique(blocks[:, 0] * self._num_blocks + blocks[:, 1])
        missing = not np.isin(keys, self._eliminated, assume_unique=True).all()
        self._eliminated = np.union1d(keys, self._eliminated)
        return bool(self._dof_map.comm.allreduce(missing, op=MPI.LOR))

    def add(self, nodes: Array, matrices: Array, others: Array | None = None) -> None:
        """Store values for `set_values`; see `BlockMatrix.add_couplings`. Not collective."""
        dofs, free = self._dofs(nodes)
        column_dofs, column_free = (dofs, free) if others is None else self._dofs(others)
        first, last = self._own_dofs
        row = (dofs >= first) & (dofs < last) & free
        which = row[:, :, None] & column_free[:, None, :]
        rows = np.broadcast_to(dofs[:, :, None], which.shape)[which]
        columns = np.broadcast_to(column_dofs[:, None, :], which.shape)[which]
        self._added.append((rows - first, columns, matrices[which]))

    def _dofs(self, nodes: Array) -> tuple[Array, Array]:
        """Return the global dofs of global nodes (n, k), and which dofs are free.

        Both are (n, components * k), node by node.
        """
        start, _ = self._dof_map.global_dofs(self._dof_map.displacement_blocks(nodes.ravel()))
        components = self._dof_map.components
        dofs = start[:, None] + np.arange(components)
        dofs = dofs.reshape(len(nodes), components * nodes.shape[1])
        return dofs, ~np.isin(dofs, self._fixed)

    def set_values(self, mat: PETSc.Mat) -> None:
        """Add the values stored by `add` to ``mat`` and discard them. ``mat`` is not assembled."""
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
