"""An AIJ matrix that element matrices are added to in place.

The pattern of a finite element space never changes, so the place of every element block in PETSc's
value arrays is found once; assembly is then an addition per value, without a search. Rows that
another rank owns are summed here first and sent as whole rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from fem_snh._petsc import aij_blocks, call, ffi
from fem_snh.errors import BadInput
from fem_snh.fem.numbering import Layout

Array = npt.NDArray[Any]


class _Graph:
    """A pattern of blocks, each row sorted, and where their values begin in an array of rows.

    rows, columns : of each block, with repeats; ``heights`` of all rows, ``widths`` of all columns.
    """

    def __init__(self, rows: Array, columns: Array, heights: Array, widths: Array) -> None:
        shape = (len(heights), len(widths))
        self._csr = csr_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=shape)
        self._csr.sum_duplicates()
        self._csr.data = np.arange(self._csr.nnz, dtype=np.int64)
        self.indptr, self.indices = self._csr.indptr, self._csr.indices
        self.heights = heights
        before = np.concatenate([[0], np.cumsum(widths[self.indices], dtype=np.int64)])
        #: unknowns in a row of each block row
        self.lengths = before[self.indptr[1:]] - before[self.indptr[:-1]]
        self.starts = np.concatenate([[0], np.cumsum(heights * self.lengths)])
        self._within = before[:-1] - np.repeat(before[self.indptr[:-1]], np.diff(self.indptr))

    def offsets(self, rows: Array, columns: Array) -> Array:
        """Where, in an array of values, the block of each pair begins."""
        if not len(rows):
            return np.empty(0, np.int64)
        return self.starts[rows] + self._within[np.asarray(self._csr[rows, columns]).ravel()]


def _ranges(starts: Array, lengths: Array) -> Array:
    """starts[0], starts[0] + 1, ..., (lengths[0] numbers), then the same for the next."""
    ends = np.cumsum(lengths)
    return np.repeat(starts - (ends - lengths), lengths) + np.arange(ends[-1] if len(ends) else 0)


class BlockMatrix:
    """An AIJ matrix on the pattern of a `Layout`'s cells, and where its blocks are. Collective.

    Attributes
    ----------
    petsc : the matrix.
    position, strides : where each block is, as cell.h's Target has it.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        nodes, n = layout.nodes, layout.nodes.shape[1]
        numbers, sizes, owned = layout.numbers, layout.sizes, layout.owned
        rows, columns = np.repeat(nodes, n, axis=1).ravel(), np.tile(nodes, (1, n)).ravel()
        near, far = owned[rows] & owned[columns], owned[rows] & ~owned[columns]
        away = ~owned[rows]

        ghost = np.cumsum(~owned) - 1  # of a local block that is not ours, its number among them
        self._sent = _Graph(ghost[rows[away]], columns[away], sizes[~owned], sizes)
        self._ghosts = numbers[~owned]
        sent_rows = np.repeat(self._ghosts, np.diff(self._sent.indptr))
        row, column = self._to_owners(sent_rows, numbers[self._sent.indices])

        _, width = layout.place(np.arange(layout.first, layout.last))
        pattern_rows = np.concatenate([numbers[rows[~away]], row]) - layout.first
        pattern_columns = np.concatenate([numbers[columns[~away]], column])
        inside = (pattern_columns >= layout.first) & (pattern_columns < layout.last)
        others = np.unique(pattern_columns[~inside])
        # PETSc keeps the columns this rank owns apart, and numbers the others densely.
        diagonal = _Graph(
            pattern_rows[inside], pattern_columns[inside] - layout.first, width, width
        )
        dense = np.searchsorted(others, pattern_columns[~inside])
        off_diagonal = _Graph(pattern_rows[~inside], dense, width, layout.place(others)[1])
        whole = np.concatenate([np.arange(layout.first, layout.last), others])
        self.petsc = self._create(diagonal, off_diagonal, whole, width)

        position = np.empty(len(rows), dtype=np.int64)
        local = numbers - layout.first
        position[near] = 4 * diagonal.offsets(local[rows[near]], local[columns[near]])
        dense = np.searchsorted(others, numbers[columns[far]])
        position[far] = 4 * off_diagonal.offsets(local[rows[far]], dense) + 1
        position[away] = 4 * self._sent.offsets(ghost[rows[away]], columns[away]) + 2
        if len(position) and position.max() > np.iinfo(np.int32).max:
            raise BadInput("too many unknowns for one rank: use more ranks (mpirun -n ...)")
        self.position = position.astype(np.int32)
        self.strides = [np.zeros(len(numbers), np.int32) for _ in range(3)]
        for stride, graph in zip(self.strides, (diagonal, off_diagonal), strict=False):
            stride[owned] = graph.lengths[local[owned]]
        self.strides[2][~owned] = self._sent.lengths

    def _to_owners(self, rows: Array, columns: Array) -> tuple[Array, Array]:
        """Send (row, column) pairs of global blocks to the ranks that own the rows. Collective."""
        comm, owner = self._layout.comm, self._layout.owner(rows)
        pairs = np.stack([rows, columns])
        received = comm.alltoall([pairs[:, owner == rank] for rank in range(comm.size)])
        return tuple(np.concatenate(received, axis=1))  # type: ignore[return-value]

    def _create(
        self, diagonal: _Graph, off_diagonal: _Graph, blocks: Array, heights: Array
    ) -> PETSc.Mat:
        """A zero AIJ matrix with both patterns; ``blocks`` are the global ones of their columns."""
        graphs, shift = (diagonal, off_diagonal), (0, len(heights))
        rows = np.concatenate(
            [np.repeat(np.arange(len(heights)), np.diff(g.indptr)) for g in graphs]
        )
        entries = np.concatenate([g.indices + s for g, s in zip(graphs, shift, strict=True)])
        order = np.lexsort((blocks[entries], rows))
        at, width = self._layout.place(blocks[entries[order]])
        columns = _ranges(at, width)  # of one row of each block row
        lengths = diagonal.lengths + off_diagonal.lengths
        starts = np.cumsum(lengths) - lengths
        block_row = np.repeat(np.arange(len(heights)), heights)
        indices = columns[_ranges(starts[block_row], lengths[block_row])].astype(PETSc.IntType)
        indptr = np.concatenate([[0], np.cumsum(lengths[block_row])]).astype(PETSc.IntType)
        size = ((self._layout.unknowns, None),) * 2
        values = np.zeros(len(indices))
        return PETSc.Mat().createAIJ(
            size,
            bsize=self._layout.block_size,
            csr=(indptr, indices, values),
            comm=self._layout.comm,
        )

    @contextmanager
    def values(self) -> Iterator[list[int]]:
        """Zero the matrix and lend the addresses of its three value arrays; assemble at the end.

        Collective.
        """
        A = self.petsc
        A.zeroEntries()
        self._sent_values[:] = 0
        sent = self._sent_values.ctypes.data
        with aij_blocks(A) as parts:
            addresses = [part.values for part in parts]
            yield [*addresses, *[0] * (2 - len(addresses)), sent]
        self._send(ffi.cast("void *", A.handle))
        A.assemble()
        A.stateIncrease()  # values changed behind PETSc's back: preconditioners must know

    @cached_property
    def _sent_values(self) -> Array:
        return np.zeros(int(self._sent.starts[-1]))

    @cached_property
    def _sent_places(self) -> tuple[Array, Array, Array, Array]:
        """PETSc's numbers of rows and columns that are sent, and where each block row's begin."""
        at, heights = self._layout.place(self._ghosts)
        rows = _ranges(at, heights).astype(PETSc.IntType)
        first, width = self._layout.place(self._layout.numbers[self._sent.indices])
        columns = _ranges(first, width).astype(PETSc.IntType)
        lengths = self._sent.lengths
        return rows, np.cumsum(heights) - heights, columns, np.cumsum(lengths) - lengths

    def _send(self, handle: Any) -> None:
        """Hand the rows of other ranks to PETSc."""
        rows, row_at, columns, column_at = self._sent_places
        values = ffi.cast("double *", self._sent_values.ctypes.data)
        row, column = (ffi.cast("int *", a.ctypes.data) for a in (rows, columns))
        add = int(PETSc.InsertMode.ADD)
        for i, (height, length) in enumerate(
            zip(self._sent.heights.tolist(), self._sent.lengths.tolist(), strict=True)
        ):
            if length:
                block = (height, row + int(row_at[i]), length, column + int(column_at[i]))
                call("MatSetValues", handle, *block, values + int(self._sent.starts[i]), add)
