"""Where each block of each element matrix is stored in the value arrays of an AIJ matrix.

A parallel AIJ matrix stores the columns a rank owns (diagonal block) apart from all others
(off-diagonal block). Contributions to rows of another rank are summed in a third array.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh._petsc import set_pattern
from fem_snh.errors import BadInput
from fem_snh.fem.block_sparsity import BlockSparsity, concatenated_ranges
from fem_snh.fem.numbering import MixedDofMap

Array = npt.NDArray[Any]

#: Which value array a block is in, as cell_api.h encodes it: 4 * offset + one of these.
_DIAGONAL, _OFF_DIAGONAL, _SENT = 0, 1, 2


class MatrixLayout:
    """The sparsity pattern of a dof map's cells, and where their blocks are stored. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns.
    pairs : (n, 2) int64, optional
        Row and column of further blocks, as global blocks; this rank owns the rows.
    mat : PETSc.Mat, optional
        A matrix of another pattern, which becomes ``mat``. Default: a new one.

    Attributes
    ----------
    mat : PETSc.Mat
        A zero AIJ matrix with this pattern.
    block_positions : (cells, n, n) int32
        For each pair of blocks of each cell 4 * offset + k: the offset of the pair's first value in
        value array k (0 diagonal block, 1 off-diagonal block, 2 sent rows).
    row_strides : list of three (local blocks,) int32
        For each of the three arrays, the values in a row of each local block.
    num_values : tuple of int
        Values in the diagonal and in the off-diagonal block.
    ghosts : (ghost blocks,) int64
        Global numbers of the ghost blocks.
    sent : BlockSparsity
        Pattern of the rows of the ghost blocks, which are sent to their owners.

    Raises
    ------
    BadInput
        If a rank has more values than a 32-bit offset can address.
    """

    def __init__(
        self,
        dof_map: MixedDofMap,
        pairs: Array | None = None,
        mat: PETSc.Mat | None = None,
    ) -> None:
        self._dof_map = dof_map
        cells, n = dof_map.cell_blocks, dof_map.cell_blocks.shape[1]
        sizes, owned, numbers = dof_map.block_sizes, dof_map.is_owned, dof_map.local_to_global
        first, last = dof_map.owned_range
        rows, columns = np.repeat(cells, n, axis=1).ravel(), np.tile(cells, (1, n)).ravel()
        sent = ~owned[rows]

        ghost = np.cumsum(~owned) - 1  # index of a ghost block among the ghosts
        self.ghosts = numbers[~owned]
        self.sent = BlockSparsity(ghost[rows[sent]], columns[sent], sizes[~owned], sizes)
        sent_rows = self.ghosts[self.sent.block_rows()]
        received = self._send_to_owners(sent_rows, numbers[self.sent.indices])

        # The pattern of the owned rows: of this rank's cells, of what other ranks send, and more.
        more = [] if pairs is None else [pairs.T]
        own = np.stack([numbers[rows[~sent]], numbers[columns[~sent]]])
        pattern_rows, pattern_columns = np.concatenate([own, received, *more], axis=1)
        pattern_rows = pattern_rows - first
        inside = (pattern_columns >= first) & (pattern_columns < last)
        # PETSc numbers the columns of the off-diagonal block densely, in ascending order.
        others = np.unique(pattern_columns[~inside])
        own_sizes = dof_map.global_dofs(np.arange(first, last))[1]
        diagonal = BlockSparsity(
            pattern_rows[inside], pattern_columns[inside] - first, own_sizes, own_sizes
        )
        off_diagonal = BlockSparsity(
            pattern_rows[~inside],
            np.searchsorted(others, pattern_columns[~inside]),
            own_sizes,
            dof_map.global_dofs(others)[1],
        )
        self.mat = self._create(diagonal, off_diagonal, others, mat)
        self.num_values = int(diagonal.row_offsets[-1]), int(off_diagonal.row_offsets[-1])

        row, column = numbers[rows] - first, numbers[columns]
        own_column, ghost_column = ~sent & owned[columns], ~sent & ~owned[columns]
        positions = np.empty(len(rows), dtype=np.int64)
        positions[own_column] = (
            4 * diagonal.offsets(row[own_column], column[own_column] - first) + _DIAGONAL
        )
        dense = np.searchsorted(others, column[ghost_column])
        positions[ghost_column] = 4 * off_diagonal.offsets(row[ghost_column], dense) + _OFF_DIAGONAL
        positions[sent] = 4 * self.sent.offsets(ghost[rows[sent]], columns[sent]) + _SENT
        if len(positions) and positions.max() > np.iinfo(np.int32).max:
            raise BadInput("too many unknowns for one rank: use more ranks (mpirun -n ...)")
        self.block_positions = positions.astype(np.int32).reshape(len(cells), n, n)
        self.row_strides = [np.zeros(len(numbers), np.int32) for _ in range(3)]
        for strides, sparsity in zip(self.row_strides, (diagonal, off_diagonal), strict=False):
            strides[owned] = sparsity.row_lengths[numbers[owned] - first]
        self.row_strides[_SENT][~owned] = self.sent.row_lengths

    def _send_to_owners(self, rows: Array, columns: Array) -> Array:
        """Send pairs of blocks to the ranks that own the rows; return (2, n) received ones."""
        comm, owner = self._dof_map.comm, self._dof_map.owner_ranks(rows)
        pairs = np.stack([rows, columns])
        received = comm.alltoall([pairs[:, owner == rank] for rank in range(comm.size)])
        return np.concatenate(received, axis=1)

    def _create(
        self,
        diagonal: BlockSparsity,
        off_diagonal: BlockSparsity,
        others: Array,
        mat: PETSc.Mat | None,
    ) -> PETSc.Mat:
        """Return a zero AIJ matrix; ``others`` are the off-diagonal block's global columns."""
        dof_map, row_sizes = self._dof_map, diagonal.row_sizes
        global_blocks = np.concatenate([np.arange(*dof_map.owned_range), others])
        rows = np.concatenate([diagonal.block_rows(), off_diagonal.block_rows()])
        columns = np.concatenate([diagonal.indices, off_diagonal.indices + len(row_sizes)])
        order = np.lexsort((global_blocks[columns], rows))
        # The columns of one row of unknowns of each block row, then repeated for its other rows.
        indices = concatenated_ranges(*dof_map.global_dofs(global_blocks[columns[order]]))
        lengths = diagonal.row_lengths + off_diagonal.row_lengths
        starts = np.cumsum(lengths) - lengths
        block_row = np.repeat(np.arange(len(row_sizes)), row_sizes)
        indices = indices[concatenated_ranges(starts[block_row], lengths[block_row])]
        indptr = np.concatenate([[0], np.cumsum(lengths[block_row])])
        integers = (array.astype(PETSc.IntType) for array in (indptr, indices))
        csr = (*integers, np.zeros(len(indices)))
        if mat is not None:
            set_pattern(mat, csr)
            return mat
        return PETSc.Mat().createAIJ(
            ((dof_map.num_owned_dofs, None),) * 2,
            bsize=dof_map.block_size,
            csr=csr,
            comm=dof_map.comm,
        )
