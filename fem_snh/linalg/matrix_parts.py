"""Parts of an assembled AIJ matrix: its diagonal, and the blocks of displacement and pressure.

PETSc searches the diagonal in every row and sorts the columns of a submatrix each time. Here the
positions of the entries are found once, and their values are copied from there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh._petsc import AIJBlock, aij_blocks, nonzero_state

Array = npt.NDArray[Any]


class Diagonal:
    """The diagonal of a square AIJ matrix, all of whose diagonal entries are in the pattern."""

    def __init__(self) -> None:
        self._pattern = (-1, -1)

    def values(self, A: PETSc.Mat) -> Array:
        """Return a copy of the diagonal, (owned rows,)."""
        with aij_blocks(A, read_only=True) as (block, *_):
            if self._pattern != (pattern := nonzero_state(A)):
                (start, column), self._pattern = block.csr(), pattern
                rows = np.arange(len(start) - 1)
                self._offsets = first_offsets(column, start[:-1], start[1:], rows)
            values: Array = block.array()[self._offsets]
            return values


class Submatrix:
    """A block of a matrix of displacement and pressure, such as B or B^T. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        An AIJ matrix whose rows begin with those of the displacement on every rank
        (`fem_snh.assembly.numbering`). Its pattern is read here, its values by `update`.
    index_sets : dict of PETSc.IS
        {"u": IS, "p": IS}, the unknowns of each field.
    rows, columns : str
        The fields of the block, "u" or "p".

    Attributes
    ----------
    matrix : PETSc.Mat
        The block.
    pattern : tuple
        The `nonzero_state` of ``A`` at construction.
    """

    def __init__(
        self, A: PETSc.Mat, index_sets: Mapping[str, PETSc.IS], rows: str, columns: str
    ) -> None:
        self.pattern = nonzero_state(A)
        self.matrix = A.createSubMatrix(index_sets[rows], index_sets[columns])
        (size, _), (num_u, _) = A.getLocalSize(), index_sets["u"].getSizes()
        chosen = slice(num_u) if rows == "u" else slice(num_u, size)
        first, counts = A.getOwnershipRanges(), np.array(A.comm.tompi4py().allgather(num_u))
        own = np.arange(size) + first[A.comm.rank]
        self._offsets: list[Array] = []
        with aij_blocks(A, read_only=True) as blocks:
            for block in blocks:
                column = block.ghosts if self._offsets else own
                owner = np.searchsorted(first, column, side="right") - 1
                is_u = column - first[owner] < counts[owner]
                self._offsets.append(_offsets(block, chosen, is_u == (columns == "u")))

    def update(self, A: PETSc.Mat) -> None:
        """Copy the values."""
        with aij_blocks(A, read_only=True) as given, aij_blocks(self.matrix) as own:
            for source, target, offsets in zip(given, own, self._offsets, strict=True):
                np.take(source.array(), offsets, out=target.array(), mode="clip")


def first_offsets(column: Array, start: Array, end: Array, bound: Array | int) -> Array:
    """Return the offset of each row's first column that is at least ``bound``.

    All rows are bisected together.

    Parameters
    ----------
    column : (n,)
        The columns, ascending in each row.
    start, end : (rows,)
        Offsets of each row's first column and past its last, which is returned if all are less.
    bound : (rows,) or int
    """
    low, high = start.copy(), end.copy()
    while (found := low >= high).sum() < len(low):
        middle = (low + high) // 2
        less = ~found & (column[np.minimum(middle, len(column) - 1)] < bound)
        low, high = np.where(less, middle + 1, low), np.where(less, high, middle)
    return low


def _offsets(block: AIJBlock, rows: slice, columns: Array) -> Array:
    """Return the offsets of the entries in these rows and in the columns where ``columns``."""
    start, column = block.csr()
    begin, end = start[rows.start or 0], start[rows.stop]
    return begin + np.flatnonzero(columns[column[begin:end]])
