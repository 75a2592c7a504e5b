"""Parts of an assembled AIJ matrix: the blocks of displacement and pressure.

PETSc sorts the columns of a submatrix each time. Here the positions of the entries are found once,
and their values are copied from there.

The matrix may be one of the displacement alone, or of displacement and pressure, of which every
rank numbers its displacement first (`fem_snh.assembly.matrix_layout`). `part_of` makes the
displacement's part of the latter a PETSc matrix that has no values of its own, so that a linear
solver which copies the values anyway (`fem_snh.linalg.ssor_cg`) needs no second copy of them in
AIJ format.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh._petsc import AIJBlock, aij_blocks, nonzero_state
from fem_snh.kernels.block_pattern import concatenated_ranges

Array = npt.NDArray[Any]


class Submatrix:
    """A block of a matrix of displacement and pressure, such as B or B^T. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        An AIJ matrix whose rows begin with those of the displacement on every rank
        (`fem_snh.assembly.matrix_layout`). Its pattern is read here, its values by `update`.
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


class BlockRows(NamedTuple):
    """The displacement's blocks in the diagonal or the off-diagonal block of an AIJ matrix.

    Attributes
    ----------
    indptr, indices : (rows + 1,), (blocks,)
        The blocks of each row and their columns; those of the off-diagonal block are numbered
        from 0.
    row_offset : (rows,) int64
        Offset of the first value of each block row.
    offset : (blocks,) int64
        Offset of the first value of each block.
    stride : (rows,) int32
        Values in each row of unknowns, of a block row all the same.
    """

    indptr: Array
    indices: Array
    row_offset: Array
    offset: Array
    stride: Array


class DisplacementBlocks(NamedTuple):
    """The displacement's blocks in one rank's rows of an AIJ matrix.

    Attributes
    ----------
    diagonal, off_diagonal : BlockRows
        Those in this rank's columns and in other ranks' columns; None on one rank.
    first : (ranks + 1,)
        First node of each rank, and the number of nodes.
    ghosts : (n,)
        Global numbers of the nodes to which the off-diagonal block's columns belong.
    """

    diagonal: BlockRows
    off_diagonal: BlockRows | None
    first: Array
    ghosts: Array


class _Part:
    """The context of `part_of`: products go through the whole matrix."""

    def __init__(self, whole: PETSc.Mat, unknowns: int) -> None:
        self.whole, self._unknowns = whole, unknowns
        self._vectors = whole.createVecs()

    def mult(self, part: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = H x."""
        whole_x, whole_y = self._vectors
        whole_x.set(0.0)
        whole_x.array[: self._unknowns] = x.array_r
        self.whole.mult(whole_x, whole_y)
        y.array[:] = whole_y.array_r[: self._unknowns]

    def destroy(self, part: PETSc.Mat) -> None:
        """Destroy what `part_of` created; PETSc calls this."""
        for vector in self._vectors:
            vector.destroy()


def part_of(A: PETSc.Mat, unknowns: int, components: int) -> PETSc.Mat:
    """Return the displacement's part of an AIJ matrix, without values of its own. Collective.

    Its state does not follow that of ``A``: ``stateIncrease`` tells solvers to read the values.

    Parameters
    ----------
    A : PETSc.Mat
    unknowns : int
        Unknowns of the displacement that this rank owns, the first of its rows.
    components : int
        Components of the displacement.
    """
    part = PETSc.Mat().create(A.comm)
    part.setSizes(((unknowns, None),) * 2, bsize=components)
    part.setType(PETSc.Mat.Type.PYTHON)
    part.setPythonContext(_Part(A, unknowns))
    part.setUp()
    return part


def stored_in(A: PETSc.Mat) -> PETSc.Mat:
    """Return the AIJ matrix that stores the values of ``A``: itself, or the whole of `part_of`."""
    if A.getType() == PETSc.Mat.Type.PYTHON:
        return A.getPythonContext().whole
    return A


def displacement_blocks(A: PETSc.Mat) -> DisplacementBlocks:
    """Return where the values of a matrix of blocks are stored. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        An AIJ matrix of the displacement alone, or one of `part_of`.
    """
    whole, comm = stored_in(A), A.comm.tompi4py()
    size = A.getBlockSize()
    counts = np.array(comm.allgather(A.getLocalSize()[0])) // size
    first = np.concatenate([[0], np.cumsum(counts)])
    rows = int(counts[comm.rank])
    with aij_blocks(whole, read_only=True) as (diagonal, *off_diagonal):
        own = _leading_blocks(diagonal, rows, size)
        if not off_diagonal:
            return DisplacementBlocks(own, None, first, np.empty(0, np.int32))
        ranges, columns = whole.getOwnershipRanges(), off_diagonal[0].ghosts
        owner = np.searchsorted(ranges, columns, side="right") - 1
        node, component = np.divmod(columns - ranges[owner], size)
        chosen = (node < counts[owner]) & (component == 0)
        number = np.full(len(columns), -1, np.int32)
        number[chosen] = np.arange(chosen.sum())
        others = _chosen_blocks(off_diagonal[0], rows, size, number)
        return DisplacementBlocks(own, others, first, (first[owner] + node)[chosen])


def _leading_blocks(block: AIJBlock, rows: int, size: int) -> BlockRows:
    """Return the blocks of a diagonal block, whose rows begin with those of the displacement."""
    start, column = block.csr()
    unknowns = size * rows
    begin = start[:unknowns:size].astype(np.int64)
    stride = np.diff(start[: unknowns + 1])[::size]
    count = stride // size
    if len(start) - 1 > unknowns:  # pressures
        count = (first_offsets(column, begin, begin + stride, unknowns) - begin) // size
    indptr = np.concatenate([[0], np.cumsum(count)])
    offset = np.arange(indptr[-1]) * size + np.repeat(begin - size * indptr[:-1], count)
    return BlockRows(indptr, column[offset] // size, begin, offset, stride.astype(np.int32))


def _chosen_blocks(block: AIJBlock, rows: int, size: int, number: Array) -> BlockRows:
    """Return the blocks of an off-diagonal block.

    Parameters
    ----------
    number : (columns,)
        The node of which a column is the first; -1 for other columns.
    """
    start, column = block.csr()
    unknowns = size * rows
    begin = start[:unknowns:size].astype(np.int64)
    stride = np.diff(start[: unknowns + 1])[::size]
    offset = concatenated_ranges(begin, stride)
    node = number[column[offset]]
    chosen = node >= 0
    row = np.repeat(np.arange(rows), stride)[chosen]
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=rows))])
    return BlockRows(indptr, node[chosen], begin, offset[chosen], stride.astype(np.int32))
