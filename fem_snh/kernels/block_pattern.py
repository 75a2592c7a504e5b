"""The sparsity pattern of blocks, and the index of each block in it, in C.

`fem_snh.fem.block_sparsity` calls it. scipy.sparse has both, but takes longer to import than a
small solve, and more memory.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels import build
from fem_snh.kernels.headers import header

Array = npt.NDArray[Any]


class BlockPattern:
    """The CSR pattern of pairs of a row and a column.

    Parameters
    ----------
    rows, columns : (n,) int
        The pairs; each may occur several times.
    num_rows, num_columns : int
        Size of the matrix.

    Attributes
    ----------
    indptr : (num_rows + 1,) int64
    indices : int32
        Columns of each row, ascending.

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


def _int32(numbers: Array) -> Array:
    return np.ascontiguousarray(numbers, dtype=np.int32)


@lru_cache
def _library() -> tuple[Any, Any]:
    declarations = header("block_pattern_api.h")
    return build.load(build.library(header("block_pattern.h")), declarations)


def concatenated_ranges(starts: Array, lengths: Array) -> Array:
    """Return the concatenation of the ranges starts[i], ..., starts[i] + lengths[i] - 1."""
    ends = np.cumsum(lengths)
    return np.repeat(starts - (ends - lengths), lengths) + np.arange(ends[-1] if len(ends) else 0)
