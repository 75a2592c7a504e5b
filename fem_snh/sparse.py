"""An AIJ matrix that element matrices are added to in place.

The pattern of a displacement space never changes, so the place of every element block in PETSc's
value arrays is found once; assembly is then an addition per value, without a search. Rows that
another rank owns are summed here first and sent as whole rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from fem_snh._petsc import call, ffi
from fem_snh.errors import BadInput

Array = npt.NDArray[Any]


def _graph(rows: Array, columns: Array, shape: tuple[int, int]) -> csr_matrix:
    """The CSR pattern of these pairs, sorted, without repeats; its data number its entries."""
    graph = csr_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=shape)
    graph.sum_duplicates()
    graph.data = np.arange(graph.nnz, dtype=np.int64)
    return graph


def _offsets(graph: csr_matrix, rows: Array, columns: Array) -> Array:
    """Where, in an array of values, the 3x3 block of each pair of nodes begins."""
    if not len(rows):
        return np.empty(0, np.int64)
    start = graph.indptr[rows].astype(np.int64)
    return 9 * start + 3 * (np.asarray(graph[rows, columns]).ravel() - start)


def _to_owners(comm: Any, first: int, rows: Array, columns: Array) -> tuple[Array, Array]:
    """Send (row, column) pairs of global nodes to the ranks that own the rows. Collective."""
    owner = np.searchsorted(comm.allgather(first), rows, side="right") - 1
    pairs = np.stack([rows, columns])
    received = comm.alltoall([pairs[:, owner == rank] for rank in range(comm.size)])
    return tuple(np.concatenate(received, axis=1))  # type: ignore[return-value]


def _create(comm: Any, pattern: csr_matrix, owned: int, total: int) -> PETSc.Mat:
    """A zero AIJ matrix with a 3x3 block for each entry of a pattern of nodes."""
    blocks = np.diff(pattern.indptr)
    indptr = np.concatenate([[0], np.cumsum(np.repeat(3 * blocks, 3))]).astype(PETSc.IntType)
    columns = (3 * pattern.indices[:, None] + np.arange(3)).astype(PETSc.IntType)
    # The columns of a node are those of each of its three rows.
    thrice = [columns[a:b] for a, b in pairwise(pattern.indptr)]
    indices = np.concatenate([np.tile(c.ravel(), 3) for c in thrice] or [columns.ravel()])
    size = ((3 * owned, 3 * total),) * 2
    values = np.zeros(len(indices))
    return PETSc.Mat().createAIJ(size, bsize=3, csr=(indptr, indices, values), comm=comm)


class BlockMatrix:
    """An AIJ matrix with 3x3 blocks on the pattern of ``nodes``, and where its blocks are.

    Parameters
    ----------
    nodes : (cells, n) local node numbers; owned nodes come before ghosts.
    owned : how many nodes this rank owns.
    global_nodes : (owned + ghosts,) global number of each local node.

    Attributes
    ----------
    petsc : the matrix.
    position, strides : where each block is, as cell.h's Target has it.
    """

    def __init__(self, comm: Any, nodes: Array, owned: int, global_nodes: Array) -> None:
        local, n = len(global_nodes), nodes.shape[1]
        first, total = comm.exscan(owned) or 0, comm.allreduce(owned)
        rows, columns = np.repeat(nodes, n, axis=1).ravel(), np.tile(nodes, (1, n)).ravel()
        away = rows >= owned
        near, far = ~away & (columns < owned), ~away & (columns >= owned)

        self._sent = _graph(rows[away] - owned, columns[away], (local - owned, local))
        self._sent_rows = global_nodes[owned:].astype(PETSc.IntType)
        self._sent_columns = global_nodes[self._sent.indices].astype(PETSc.IntType)
        self._sent_values = np.zeros(9 * self._sent.nnz)
        mine = self._sent.tocoo()
        row, column = _to_owners(
            comm, first, global_nodes[mine.row + owned], global_nodes[mine.col]
        )
        pattern = _graph(
            np.concatenate([rows[~away], row - first]),
            np.concatenate([global_nodes[columns[~away]], column]),
            (owned, total),
        )
        self.petsc = _create(comm, pattern, owned, total)

        # PETSc keeps the columns this rank owns apart, and numbers the others densely.
        inside = (pattern.indices >= first) & (pattern.indices < first + owned)
        row_of = np.repeat(np.arange(owned), np.diff(pattern.indptr))
        others = np.unique(pattern.indices[~inside])
        diagonal = _graph(row_of[inside], pattern.indices[inside] - first, (owned, owned))
        dense = np.searchsorted(others, pattern.indices[~inside])
        off_diagonal = _graph(row_of[~inside], dense, (owned, len(others)))

        position = np.empty(len(rows), dtype=np.int64)
        position[near] = 4 * _offsets(diagonal, rows[near], columns[near])
        dense = np.searchsorted(others, global_nodes[columns[far]])
        position[far] = 4 * _offsets(off_diagonal, rows[far], dense) + 1
        position[away] = 4 * _offsets(self._sent, rows[away] - owned, columns[away]) + 2
        if len(position) and position.max() > np.iinfo(np.int32).max:
            raise BadInput("too many unknowns for one rank: use more ranks (mpirun -n ...)")
        self.position = position.astype(np.int32)
        ghosts = local - owned
        self.strides = [
            np.pad(3 * np.diff(graph.indptr), pad).astype(np.int32)
            for graph, pad in (
                (diagonal, (0, ghosts)),
                (off_diagonal, (0, ghosts)),
                (self._sent, (owned, 0)),
            )
        ]

    @contextmanager
    def values(self) -> Iterator[list[int]]:
        """Zero the matrix and lend the addresses of its three value arrays; assemble at the end.

        Collective.
        """
        A = self.petsc
        A.zeroEntries()
        self._sent_values[:] = 0
        handle, parts = ffi.cast("void *", A.handle), ffi.new("void *[2]")
        if A.getType() == PETSc.Mat.Type.SEQAIJ:
            parts[0] = handle
        else:
            columns = ffi.new("int **")
            call("MatMPIAIJGetSeqAIJ", handle, parts, parts + 1, columns)
        arrays = ffi.new("double *[2]")
        present = [k for k in range(2) if parts[k] != ffi.NULL]
        for k in present:
            call("MatSeqAIJGetArray", parts[k], arrays + k)
        sent = self._sent_values.ctypes.data
        yield [*(int(ffi.cast("intptr_t", arrays[k])) for k in range(2)), sent]
        for k in present:
            call("MatSeqAIJRestoreArray", parts[k], arrays + k)
        self._send(handle)
        A.assemble()
        A.stateIncrease()  # values changed behind PETSc's back: preconditioners must know

    def _send(self, handle: Any) -> None:
        """Hand the rows of other ranks to PETSc."""
        values = ffi.cast("double *", self._sent_values.ctypes.data)
        columns = ffi.cast("int *", self._sent_columns.ctypes.data)
        rows = ffi.cast("int *", self._sent_rows.ctypes.data)
        starts = self._sent.indptr.tolist()
        add = int(PETSc.InsertMode.ADD)
        for i, (a, b) in enumerate(pairwise(starts)):
            if b > a:
                block = (handle, 1, rows + i, b - a, columns + a, values + 9 * a, add)
                call("MatSetValuesBlocked", *block)
