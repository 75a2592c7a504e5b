r"""Rows and columns of nodes that follow a few unknowns, folded into those of these unknowns.

The displacement of the nodes of a rigid part is a function of six unknowns q. With its derivative
:math:`B = \partial u / \partial q` the rows and columns of the nodes become
:math:`B^T A` and :math:`A B`. Two nodes of the part lend their rows, columns and vector entries to
q, so that the numbering and the blocks of the matrix stay as they are. All other rows and columns
of the part are those of constrained unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from fem_snh._petsc import AIJBlock, aij_blocks, nonzero_state
from fem_snh.assembly.matrix_layout import MixedDofMap

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

#: Unknowns of a part.
UNKNOWNS = 6


class Folding:
    """The nodes of parts with six unknowns each, and the fold of an assembled matrix. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns, the displacement's before others.
    nodes, labels : (n,) int
        This rank's own nodes of the parts, and the part of each.
    slots : (parts, 2) int
        The global nodes that lend their entries to the free unknowns of each part, in order.
    free : (6 parts,) bool
        Which of the unknowns are free.
    chains : sequence of sequences of int
        For each part the parts whose unknowns move it, itself included.

    Attributes
    ----------
    eliminated : (m,) int
        The entries of this rank's vectors that are no unknowns: of nodes that are no slots, and of
        unknowns that are not free.
    unknowns : (6 parts,) int
        The global entries of the unknowns, -1 for those that are not free.
    own_unknowns : tuple of two (k,) int
        The entries of the unknowns in this rank's vectors, and their numbers.
    """

    def __init__(
        self,
        dof_map: MixedDofMap,
        nodes: Indices,
        labels: Indices,
        slots: Indices,
        free: Array,
        chains: Sequence[Sequence[int]],
    ) -> None:
        self._dof_map, self._comm = dof_map, dof_map.comm
        self._labels, parts = labels, len(slots)
        size = dof_map.components
        self._rows = (size * nodes[:, None] + np.arange(size)).ravel()
        self._first = self._comm.exscan(dof_map.num_owned_dofs) or 0
        own = self._first + self._rows
        self._own = own
        self._slaves = np.sort(np.concatenate(self._comm.allgather(own)))
        self._slot_blocks = dof_map.displacement_blocks(slots.ravel()).reshape(-1, 2)
        starts = dof_map.global_dofs(self._slot_blocks.ravel())[0]
        entries = (starts[:, None] + np.arange(size)).reshape(parts, -1)
        order = np.cumsum(free.reshape(parts, -1), axis=1) - 1
        entries = np.take_along_axis(entries, np.maximum(order, 0), axis=1)
        self.unknowns = np.where(free, entries.ravel(), -1)
        self._free, self._chains, size = free, chains, UNKNOWNS * parts
        self.eliminated = self._rows[~np.isin(own, self.unknowns)]
        which = np.flatnonzero(np.isin(self.unknowns, own))
        self.own_unknowns = self.unknowns[which] - self._first, which
        self.set_state(np.zeros((len(own), UNKNOWNS)), np.eye(size), np.zeros((size, size)))
        self._pattern: tuple[int, ...] = ()

    def set_state(
        self, basis: Array, jacobian: Array, stiffness: Array, symmetric: bool = True
    ) -> None:
        """Set the derivatives and the stiffness by which `apply` eliminates the nodes of parts.

        Parameters
        ----------
        basis : (components n, 6) array
            The derivative of the displacement of this rank's nodes by the twist of their part.
        jacobian : (6 parts, 6 parts) array
            The derivative of the twists by the unknowns.
        stiffness : (6 parts, 6 parts) array
            A matrix that is added to the rows and columns of the unknowns.
        symmetric : bool
            Whether the matrix is symmetric, but for rounding.
        """
        self._basis, self._jacobian, self._stiffness = basis, jacobian, stiffness
        self._symmetric = symmetric

    def pairs(self, mat: PETSc.Mat) -> Indices:
        """Return the pairs of global blocks that the fold of a matrix needs, (n, 2). Collective.

        They are those in the rows that this rank owns.
        """
        dof_map, parts = self._dof_map, len(self._slot_blocks)
        part_of_row = np.full(dof_map.num_owned_dofs, -1)
        part_of_row[self._rows] = np.repeat(self._labels, dof_map.components)
        found = [np.empty((2, 0), np.int64)]
        with aij_blocks(mat, read_only=True) as blocks:
            for block in blocks:
                rows, columns = self._entries(block, block is not blocks[0])
                part = part_of_row[rows]
                of_part = part >= 0
                keys = np.unique(part[of_part] * (2**40) + columns[of_part])
                found.append(np.stack(np.divmod(keys, 2**40)))
        part, columns = np.unique(
            np.concatenate(self._comm.allgather(np.concatenate(found, axis=1)), axis=1), axis=1
        )
        self._columns = np.unique(columns)
        others = ~np.isin(columns, self._slaves)
        part, neighbours = np.unique(
            np.stack([part[others], dof_map.blocks_of(columns[others])]), axis=1
        )
        chain = [np.array(self._chains[p]) for p in part]
        neighbours = np.repeat(neighbours, [len(c) for c in chain])
        part = np.concatenate([np.empty(0, np.int64), *chain])
        pairs = [np.stack([self._slot_blocks[part, k], neighbours], axis=1) for k in range(2)]
        pairs += [pair[:, ::-1] for pair in pairs]
        slots = self._slot_blocks.ravel()
        pairs.append(np.stack([np.repeat(slots, 2 * parts), np.tile(slots, 2 * parts)], axis=1))
        every = np.concatenate(pairs)
        first, last = dof_map.owned_range
        return every[(every[:, 0] >= first) & (every[:, 0] < last)]

    def apply(self, mat: PETSc.Mat) -> None:
        """Fold the rows and columns of an assembled matrix, whose pattern has `pairs`. Collective.

        The diagonal of eliminated entries is zero then.
        """
        with aij_blocks(mat) as blocks:
            if self._pattern != (pattern := nonzero_state(mat)):
                self._locate(blocks)
                self._pattern = pattern
            arrays = [block.array() for block in blocks]
            rows, square = self._folded(arrays)
        columns = rows
        if self._symmetric:
            square = (square + square.T) / 2
        else:  # the pattern is symmetric, so the transpose has the same
            transpose = mat.transpose(PETSc.Mat())  # without an argument in place
            with aij_blocks(transpose, read_only=True) as blocks:
                columns = self._folded([block.array() for block in blocks])[0]
            transpose.destroy()
        square = (square + self._stiffness) * np.outer(self._free, self._free)
        unknowns = np.concatenate([part.ravel() for part in (rows, columns, square)])
        with aij_blocks(mat) as blocks:
            arrays = [block.array() for block in blocks]
            for array, (zeros, targets, sources) in zip(arrays, self._targets, strict=True):
                array[zeros] = 0.0
                array[targets] += unknowns[sources]

    def _folded(self, arrays: Sequence[Array]) -> tuple[Array, Array]:
        """Return B^T A in the columns of other nodes, and B^T A B."""
        size, G = len(self._jacobian), self._jacobian
        row = np.arange(len(self._own))
        column = UNKNOWNS * np.repeat(self._labels, self._dof_map.components)[:, None] + np.arange(
            UNKNOWNS
        )
        index = np.repeat(row, UNKNOWNS), column.ravel()
        B = csr_matrix((self._basis.ravel(), index), shape=(len(row), size))
        rows = np.zeros((size, len(self._columns)))
        for array, (entries, *position) in zip(arrays, self._slave_rows, strict=True):
            shape = len(row), len(self._columns)
            rows += (B.T @ csr_matrix((array[entries], position), shape=shape)).toarray()
        rows = self._comm.allreduce(rows)
        square = self._comm.allreduce(rows[:, self._own_columns] @ B)
        return (G.T @ rows) * self._free[:, None], G.T @ square @ G

    def _entries(self, block: AIJBlock, ghosts: bool) -> tuple[Indices, Indices]:
        """Return the local row and the global column of each value of a block of the matrix."""
        indptr, indices = block.csr()
        rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        columns = block.ghosts[indices] if ghosts else indices + self._first
        return rows, columns.astype(np.int64)

    def _locate(self, blocks: Sequence[AIJBlock]) -> None:
        """Find the values that are read, set to zero and added to."""
        number = np.full(self._dof_map.num_owned_dofs, -1)
        number[self._rows] = np.arange(len(self._rows))
        columns, size = self._columns, len(self.unknowns)
        self._own_columns = np.searchsorted(columns, self._own)
        order = np.argsort(self.unknowns)
        in_order = self.unknowns[order]

        def slot(dofs: Indices) -> Indices:
            at = np.minimum(np.searchsorted(in_order, dofs), size - 1)
            return np.where(in_order[at] == dofs, order[at], -1)

        self._slave_rows, self._targets = [], []
        for block in blocks:
            row, column = self._entries(block, block is not blocks[0])
            global_row = row + self._first
            slave_row, slave_column = number[row] >= 0, np.isin(column, self._slaves)
            entries = np.flatnonzero(slave_row)
            self._slave_rows.append(
                (entries, number[row[entries]], np.searchsorted(columns, column[entries]))
            )
            zeros = np.flatnonzero(slave_row | slave_column)
            row_slot, column_slot = slot(global_row[zeros]), slot(column[zeros])
            sources = np.full(len(zeros), -1)
            # A row or a column of a slot and another node, and of two slots.
            for first, unknown, other, foreign in (
                (0, row_slot, column[zeros], ~slave_column[zeros]),
                (size, column_slot, global_row[zeros], ~slave_row[zeros]),
            ):
                at = np.minimum(np.searchsorted(columns, other), len(columns) - 1)
                chosen = (unknown >= 0) & foreign & (columns[at] == other)
                sources[chosen] = (first + unknown[chosen]) * len(columns) + at[chosen]
            both = (row_slot >= 0) & (column_slot >= 0)
            sources[both] = 2 * size * len(columns) + row_slot[both] * size + column_slot[both]
            filled = sources >= 0
            self._targets.append((zeros, zeros[filled], sources[filled]))
