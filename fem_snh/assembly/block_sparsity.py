"""The sparsity pattern of a matrix of blocks, and the offset of each block in its value array."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels.block_pattern import Pattern

Array = npt.NDArray[Any]


class BlockSparsity:
    """A CSR pattern of blocks whose values are stored row by row of unknowns, as in AIJ.

    Parameters
    ----------
    pattern : Pattern
        The blocks.
    row_sizes, column_sizes : (block rows,), (block columns,) int
        Unknowns of each block row and of each block column.

    Attributes
    ----------
    indptr, indices : int arrays
        The CSR pattern of blocks, columns sorted.
    row_sizes : (block rows,) int
        As given.
    row_lengths : (block rows,) int
        Values in one row of unknowns of each block row: the stride between rows of a block.
    row_offsets : (block rows + 1,) int
        Offset of each block row's first value.
    block_offsets : (blocks,) int
        Offset of each block's first value.
    """

    def __init__(self, pattern: Pattern, row_sizes: Array, column_sizes: Array) -> None:
        self._pattern = pattern
        self.indptr, self.indices = pattern.indptr, pattern.indices
        self.row_sizes = row_sizes
        before = np.concatenate([[0], np.cumsum(column_sizes[self.indices], dtype=np.int64)])
        row_start = before[self.indptr[:-1]]
        self.row_lengths = before[self.indptr[1:]] - row_start
        self.row_offsets = np.concatenate([[0], np.cumsum(row_sizes * self.row_lengths)])
        shift = np.repeat(self.row_offsets[:-1] - row_start, np.diff(self.indptr))
        self.block_offsets = np.add(before[:-1], shift, out=shift)

    def block_rows(self) -> Array:
        """Return the block row of each block of the pattern."""
        return self._pattern.rows()

    def offsets(self, rows: Array, columns: Array) -> Array:
        """Return the offset of the first value of each of these blocks in the value array."""
        return np.asarray(self.block_offsets[self._pattern.find(rows, columns)])
