"""An AIJ matrix into whose value arrays element matrices are added directly.

``MatSetValues`` searches the row of every value for its column, in every assembly. The sparsity
pattern of a finite element space never changes, so `BlockMatrix` looks up once where each block of
each element matrix is stored in PETSc's value arrays. The compiled cell loops then add to these
addresses, without a search and without storing element matrices (as ``MatSetValuesCOO`` needs).
``python -m benchmarks assembly`` compares the time per cell with dolfinx's assembly by
``MatSetValues``, ``python -m benchmarks coo_assembly`` with ``MatSetValuesCOO``.

A parallel AIJ matrix stores the columns a rank owns (diagonal block) apart from all others
(off-diagonal block). Contributions to rows of another rank are summed in a third array, and each of
these rows is sent to its owner once per assembly, by ``MatSetValues``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh._petsc import aij_blocks, call, ffi
from fem_snh.errors import BadInput
from fem_snh.fem.block_sparsity import BlockSparsity, concatenated_ranges
from fem_snh.fem.numbering import MixedDofMap

Array = npt.NDArray[Any]

#: Which value array a block is in, as cell_api.h encodes it: 4 * offset + one of these.
_DIAGONAL, _OFF_DIAGONAL, _SENT = 0, 1, 2


class BlockMatrix:
    """An AIJ matrix with the sparsity pattern of a dof map's cells. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns.

    Attributes
    ----------
    mat : PETSc.Mat
        The matrix.
    block_positions : (cells * n * n,) int32
        For each pair of blocks of each cell 4 * offset + k: the offset of the pair's first value in
        value array k (0 diagonal block, 1 off-diagonal block, 2 sent rows).
    row_strides : list of three (local blocks,) int32
        For each of the three arrays, the values in a row of each local block.

    Raises
    ------
    BadInput
        If a rank has more values than a 32-bit offset can address.
    """

    def __init__(self, dof_map: MixedDofMap) -> None:
        self._dof_map = dof_map
        cells, n = dof_map.cell_blocks, dof_map.cell_blocks.shape[1]
        sizes, owned, numbers = dof_map.block_sizes, dof_map.is_owned, dof_map.local_to_global
        first, last = dof_map.owned_range
        rows, columns = np.repeat(cells, n, axis=1).ravel(), np.tile(cells, (1, n)).ravel()
        sent = ~owned[rows]

        ghost = np.cumsum(~owned) - 1  # index of a ghost block among the ghosts
        self._ghosts = numbers[~owned]
        self._sent = BlockSparsity(ghost[rows[sent]], columns[sent], sizes[~owned], sizes)
        sent_rows = self._ghosts[self._sent.block_rows()]
        received = self._send_to_owners(sent_rows, numbers[self._sent.indices])

        # The pattern of the owned rows: of this rank's cells, and of what other ranks send.
        pattern_rows = np.concatenate([numbers[rows[~sent]], received[0]]) - first
        pattern_columns = np.concatenate([numbers[columns[~sent]], received[1]])
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
        self.mat = self._create(diagonal, off_diagonal, others)

        row, column = numbers[rows] - first, numbers[columns]
        own_column, ghost_column = ~sent & owned[columns], ~sent & ~owned[columns]
        positions = np.empty(len(rows), dtype=np.int64)
        positions[own_column] = (
            4 * diagonal.offsets(row[own_column], column[own_column] - first) + _DIAGONAL
        )
        dense = np.searchsorted(others, column[ghost_column])
        positions[ghost_column] = 4 * off_diagonal.offsets(row[ghost_column], dense) + _OFF_DIAGONAL
        positions[sent] = 4 * self._sent.offsets(ghost[rows[sent]], columns[sent]) + _SENT
        if len(positions) and positions.max() > np.iinfo(np.int32).max:
            raise BadInput("too many unknowns for one rank: use more ranks (mpirun -n ...)")
        self.block_positions = positions.astype(np.int32)
        self.row_strides = [np.zeros(len(numbers), np.int32) for _ in range(3)]
        for strides, sparsity in zip(self.row_strides, (diagonal, off_diagonal), strict=False):
            strides[owned] = sparsity.row_lengths[numbers[owned] - first]
        self.row_strides[_SENT][~owned] = self._sent.row_lengths

    def _send_to_owners(self, rows: Array, columns: Array) -> Array:
        """Send pairs of blocks to the ranks that own the rows; return (2, n) received ones."""
        comm, owner = self._dof_map.comm, self._dof_map.owner_ranks(rows)
        pairs = np.stack([rows, columns])
        received = comm.alltoall([pairs[:, owner == rank] for rank in range(comm.size)])
        return np.concatenate(received, axis=1)

    def _create(
        self, diagonal: BlockSparsity, off_diagonal: BlockSparsity, others: Array
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
        return PETSc.Mat().createAIJ(
            ((dof_map.num_owned_dofs, None),) * 2,
            bsize=dof_map.block_size,
            csr=(
                indptr.astype(PETSc.IntType),
                indices.astype(PETSc.IntType),
                np.zeros(len(indices)),
            ),
            comm=dof_map.comm,
        )

    @contextmanager
    def value_addresses(self) -> Iterator[list[int]]:
        """Zero the matrix, provide the addresses of its three value arrays, and assemble it.

        An array that does not exist has the address 0. Collective.
        """
        self.mat.zeroEntries()
        self._sent_values[:] = 0
        with aij_blocks(self.mat) as blocks:
            addresses = [block.values for block in blocks]
            missing = [0] * (2 - len(addresses))
            yield [*addresses, *missing, self._sent_values.ctypes.data]
        self._send_values()
        self.mat.assemble()
        # Preconditioners compare this counter; writing to the arrays does not increase it.
        self.mat.stateIncrease()

    @cached_property
    def _sent_values(self) -> Array:
        return np.zeros(int(self._sent.row_offsets[-1]))

    @cached_property
    def _sent_dofs(self) -> tuple[Array, Array, Array, Array]:
        """Global dofs of the sent rows and columns, and where those of each block row begin."""
        dofs, sizes = self._dof_map.global_dofs(self._ghosts)
        rows = concatenated_ranges(dofs, sizes).astype(PETSc.IntType)
        blocks = self._dof_map.local_to_global[self._sent.indices]
        columns = concatenated_ranges(*self._dof_map.global_dofs(blocks)).astype(PETSc.IntType)
        lengths = self._sent.row_lengths
        return rows, np.cumsum(sizes) - sizes, columns, np.cumsum(lengths) - lengths

    def _send_values(self) -> None:
        """Pass the rows of other ranks to PETSc, which sends them when it assembles."""
        rows, row_start, columns, column_start = self._sent_dofs
        handle = ffi.cast("void *", self.mat.handle)
        values = ffi.cast("double *", self._sent_values.ctypes.data)
        row, column = (ffi.cast("int *", a.ctypes.data) for a in (rows, columns))
        add = int(PETSc.InsertMode.ADD)
        sizes, lengths = self._sent.row_sizes.tolist(), self._sent.row_lengths.tolist()
        for i, (size, length) in enumerate(zip(sizes, lengths, strict=True)):
            if length:
                block = (size, row + int(row_start[i]), length, column + int(column_start[i]))
                offset = int(self._sent.row_offsets[i])
                call("MatSetValues", handle, *block, values + offset, add)
