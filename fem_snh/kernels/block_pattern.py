"""The sparsity pattern of blocks, and the index of each block in it, in C.

`fem_snh.assembly.matrix_layout` calls it. scipy.sparse has both, but takes longer to import than a
small solve, and more memory.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels import build
from fem_snh.kernels.build import header

Array = npt.NDArray[Any]


class Pattern:
    """A CSR pattern.

    Attributes
    ----------
    indptr : (rows + 1,) int64
    indices : int32
        Columns of each row, ascending.
    """

    indptr: Array
    indices: Array

    def rows(self) -> Array:
        """Return the row (n,) int32 of each pair of the pattern."""
        return np.repeat(np.arange(len(self.indptr) - 1, dtype=np.int32), np.diff(self.indptr))

    def find(self, rows: Array, columns: Array) -> Array:
        """Return the index (n,) int64 of each pair in `indices`; KeyError if one is not there."""
        rows, columns = _int32(rows), _int32(columns)
        found = np.empty(len(rows), np.int64)
        ffi, lib = _library()
        missing = lib.block_indices(
            len(rows),
            *(ffi.cast("int *", a.ctypes.data) for a in (rows, columns)),
            ffi.cast("long *", self.indptr.ctypes.data),
            ffi.cast("int *", self.indices.ctypes.data),
            ffi.cast("long *", found.ctypes.data),
        )
        if missing:
            raise KeyError(f"{missing} blocks are not in the pattern")
        return found


class BlockPattern(Pattern):
    """The pattern of pairs of a row and a column.

    Parameters
    ----------
    rows, columns : (n,) int
        The pairs; each may occur several times.
    num_rows, num_columns : int
        Size of the matrix.

    Raises
    ------
    MemoryError
        If memory is exhausted.
    """

    def __init__(self, rows: Array, columns: Array, num_rows: int, num_columns: int) -> None:
        rows, columns = _int32(rows), _int32(columns)
        self.indptr = np.zeros(num_rows + 1, np.int64)
        indices = np.empty(len(rows), np.int32)
        ffi, lib = _library()
        if lib.block_pattern(
            len(rows),
            *(ffi.cast("int *", a.ctypes.data) for a in (rows, columns)),
            num_rows,
            num_columns,
            ffi.cast("long *", self.indptr.ctypes.data),
            ffi.cast("int *", indices.ctypes.data),
        ):
            raise MemoryError
        self.indices = indices[: self.indptr[-1]].copy()


class CellPattern(Pattern):
    """The pattern of the pairs of blocks of cells.

    Parameters
    ----------
    cells : (cells, n) int
        The blocks of each cell.
    num_blocks : int
        Size of the matrix.

    Raises
    ------
    MemoryError
        If memory is exhausted.
    """

    def __init__(self, cells: Array, num_blocks: int) -> None:
        self._cells, self._num_blocks = _int32(cells), num_blocks
        self.indptr = np.zeros(num_blocks + 1, np.int64)
        ffi, lib = _library()
        indptr = ffi.cast("long *", self.indptr.ctypes.data)
        size = lib.cell_pattern(*self._of_cells(), indptr, ffi.NULL)
        if size < 0:
            raise MemoryError
        self.indices = np.empty(size, np.int32)
        indices = ffi.cast("int *", self.indices.ctypes.data)
        if lib.cell_pattern(*self._of_cells(), indptr, indices) < 0:
            raise MemoryError

    def of_cells(self, values: Array) -> Array:
        """Return the value of each pair of blocks of each cell, (cells, n, n) int32.

        Parameters
        ----------
        values : (pairs of the pattern,) int32
        """
        n = self._cells.shape[1]
        values, found = _int32(values), np.empty((len(self._cells), n, n), np.int32)
        ffi, lib = _library()
        arrays = self.indices, values, found
        if lib.cell_positions(
            *self._of_cells(),
            ffi.cast("long *", self.indptr.ctypes.data),
            *(ffi.cast("int *", array.ctypes.data) for array in arrays),
        ):
            raise MemoryError
        return found

    def _of_cells(self) -> tuple[Any, ...]:
        """Return the first arguments of the compiled functions."""
        pointer = _library()[0].cast("int *", self._cells.ctypes.data)
        return (*self._cells.shape, pointer, self._num_blocks)


def unknown_columns(
    row_sizes: Array,
    own: tuple[Array, Array, Array, Array],
    others: tuple[Array, Array, Array, Array],
    before: int,
    count: int,
) -> Array:
    """Return the columns of every row of unknowns of this rank's block rows, ascending.

    Parameters
    ----------
    row_sizes : (block rows,)
        Unknowns of each block row.
    own, others : tuple of arrays
        The pattern of this rank's block columns, and of those of other ranks: indptr, indices, and
        first unknown and size of each block column.
    before : int
        The first column of ``others`` that comes after this rank's.
    count : int
        Number of columns in all rows.

    Returns
    -------
    (count,) int32
    """
    ffi, lib = _library()
    columns, sizes = np.empty(count, np.int32), _int32(row_sizes)

    def pointer(kind: str, array: Array) -> Any:
        return ffi.cast(kind, array.ctypes.data)

    kept, structs = [], []  # the structs hold pointers into the arrays
    for indptr, *rest in (own, others):
        arrays = [np.ascontiguousarray(indptr, np.int64), *(_int32(of) for of in rest)]
        kept += arrays
        kinds = "long *", "int *", "int *", "int *"
        pointers = [pointer(kind, of) for kind, of in zip(kinds, arrays, strict=True)]
        structs.append(ffi.new("BlockColumns *", pointers))
    lib.unknown_columns(
        len(sizes), pointer("int *", sizes), *structs, before, pointer("int *", columns)
    )
    return columns


def _int32(numbers: Array) -> Array:
    return np.ascontiguousarray(numbers, dtype=np.int32)


@lru_cache
def _library() -> tuple[Any, Any]:
    declarations = header("block_pattern_api.h")
    source = declarations + header("block_pattern.h")
    return build.load(build.library(source), declarations)


def concatenated_ranges(starts: Array, lengths: Array) -> Array:
    """Return the concatenation of the ranges starts[i], ..., starts[i] + lengths[i] - 1."""
    ends = np.cumsum(lengths)
    return np.repeat(starts - (ends - lengths), lengths) + np.arange(ends[-1] if len(ends) else 0)
