"""Compute the CSR pattern of a block matrix and the index of each block in the pattern, in C.

`fem_snh.assembly.matrix_layout` calls this module. scipy.sparse could do the same, but takes longer
to import than a small solve, and needs more memory.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from fem_snh.arrays import Array
from fem_snh.kernels import build

if TYPE_CHECKING:
    from _cffi_backend import FFI, CData, Lib


class Pattern:
    """A CSR sparsity pattern: a set of pairs (row, column).

    Parameters
    ----------
    indptr : (rows + 1,) int
        Index of each row's first pair.
    indices : (pairs,) int32
        The columns, ascending within each row.

    Attributes
    ----------
    indptr, indices
        The parameters; ``indptr`` is int64.
    """

    def __init__(self, indptr: Array, indices: Array) -> None:
        self.indptr, self.indices = indptr.astype(np.int64, copy=False), indices

    def rows(self) -> Array:
        """Return the row of each pair of the pattern, (pairs,) int32."""
        return np.repeat(np.arange(len(self.indptr) - 1, dtype=np.int32), np.diff(self.indptr))

    def find(self, rows: Array, columns: Array) -> Array:
        """Return the index in `indices` of each pair (rows[k], columns[k]), (n,) int64.

        Raises KeyError if a pair is not in the pattern.
        """
        rows, columns = _int32(rows), _int32(columns)
        found = np.empty(len(rows), np.int64)
        missing = _library()[1].block_indices(
            len(rows), *_pointers(rows, columns, self.indptr, self.indices, found)
        )
        if missing:
            raise KeyError(f"{missing} blocks are not in the pattern")
        return found


class BlockPattern(Pattern):
    """The pattern of given pairs (row, column).

    Parameters
    ----------
    rows, columns : (n,) int
        The pairs (rows[k], columns[k]), which may repeat.
    num_rows, num_columns : int
        Size of the matrix.

    Raises
    ------
    MemoryError
        If memory is exhausted.
    """

    def __init__(self, rows: Array, columns: Array, num_rows: int, num_columns: int) -> None:
        rows, columns = _int32(rows), _int32(columns)
        indptr, indices = np.zeros(num_rows + 1, np.int64), np.empty(len(rows), np.int32)
        pairs, pattern = _pointers(rows, columns), _pointers(indptr, indices)
        if _library()[1].block_pattern(len(rows), *pairs, num_rows, num_columns, *pattern):
            raise MemoryError
        super().__init__(indptr, indices[: indptr[-1]].copy())


class CellPattern(Pattern):
    """The symmetric pattern that couples all blocks of each cell with each other.

    Parameters
    ----------
    cells : (cells, n) int
        The numbers of each cell's blocks.
    num_blocks : int
        Number of block rows and of block columns.

    Raises
    ------
    MemoryError
        If memory is exhausted.
    """

    def __init__(self, cells: Array, num_blocks: int) -> None:
        self._cells, self._num_blocks = _int32(cells), num_blocks
        super().__init__(np.zeros(num_blocks + 1, np.int64), np.empty(0, np.int32))
        ffi, lib = _library()
        (indptr,) = _pointers(self.indptr)
        size = lib.cell_pattern(*self._of_cells(), indptr, ffi.NULL)
        if size < 0:
            raise MemoryError
        self.indices = np.empty(size, np.int32)
        if lib.cell_pattern(*self._of_cells(), indptr, *_pointers(self.indices)) < 0:
            raise MemoryError

    def of_cells(self, values: Array) -> Array:
        """Return the value that belongs to each pair of blocks of each cell, (cells, n, n) int32.

        Parameters
        ----------
        values : (pairs,) int32
            One value for each pair of the pattern, in the order of `indices`.
        """
        n = self._cells.shape[1]
        values, found = _int32(values), np.empty((len(self._cells), n, n), np.int32)
        arrays = _pointers(self.indptr, self.indices, values, found)
        if _library()[1].cell_positions(*self._of_cells(), *arrays):
            raise MemoryError
        return found

    def _of_cells(self) -> tuple[Any, ...]:
        """Return the arguments (cells, n, blocks, num_blocks) of the compiled functions."""
        return (*self._cells.shape, *_pointers(self._cells), self._num_blocks)


def unknown_columns(
    row_sizes: Array,
    own: tuple[Array, Array, Array, Array],
    others: tuple[Array, Array, Array, Array],
    before: int,
    count: int,
) -> Array:
    """Return the column numbers of this rank's scalar rows, row after row, from block patterns.

    Parameters
    ----------
    row_sizes : (block rows,)
        Number of scalar rows (unknowns) in each block row.
    own : tuple of arrays
        The pattern of this rank's block columns: indptr, indices, and the first unknown and the
        size of each block column.
    others : tuple of arrays
        The same for the block columns of other ranks.
    before : int
        How many block columns of ``others`` precede the columns of this rank.
    count : int
        Number of entries of all scalar rows.

    Returns
    -------
    (count,) int32
        Ascending within each row.
    """
    ffi, lib = _library()
    columns, sizes = np.empty(count, np.int32), _int32(row_sizes)
    kept = [  # the structs hold pointers into the arrays
        [np.ascontiguousarray(indptr, np.int64), *map(_int32, rest)]
        for indptr, *rest in (own, others)
    ]
    structs = [ffi.new("BlockColumns *", _pointers(*arrays)) for arrays in kept]
    of_sizes, of_columns = _pointers(sizes, columns)
    lib.unknown_columns(len(sizes), of_sizes, *structs, before, of_columns)
    return columns


def _int32(numbers: Array) -> Array:
    return np.ascontiguousarray(numbers, dtype=np.int32)


def _pointers(*arrays: Array) -> list[CData]:
    return [build.pointer(_library()[0], array) for array in arrays]


@lru_cache
def _library() -> tuple[FFI, Lib]:
    return build.open_library(["block_pattern_api.h"], ["block_pattern.h"])


def concatenated_ranges(starts: Array, lengths: Array) -> Array:
    """Return the concatenated ranges starts[i], ..., starts[i] + lengths[i] - 1 as one array."""
    ends = np.cumsum(lengths)
    return np.repeat(starts - (ends - lengths), lengths) + np.arange(ends[-1] if len(ends) else 0)
