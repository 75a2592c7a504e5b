"""The rows of a matrix to which a rank contributes without owning them.

``MatSetValues`` would search every value's column in its row, in every assembly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.matrix_layout import MatrixLayout, Received
from fem_snh.assembly.numbering import MixedDofMap
from fem_snh.kernels.block_pattern import concatenated_ranges

Array = npt.NDArray[Any]


class SentRows:
    """Values of the rows of ghost blocks, which are sent to their owners. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns.
    layout : MatrixLayout
        The pattern of these rows, and of those that other ranks send.

    Attributes
    ----------
    values : (n,) float64
        The values, row by row.
    """

    def __init__(self, dof_map: MixedDofMap, layout: MatrixLayout) -> None:
        self._comm, offsets = dof_map.comm, layout.sent.row_offsets
        self.values = np.zeros(int(offsets[-1]))
        owner, lengths = dof_map.owner_ranks(layout.ghosts), np.diff(offsets)
        self._sent = {}
        for rank in np.unique(owner[lengths > 0]):  # none: a ghost of no cell of this rank
            rows = owner == rank
            chosen = concatenated_ranges(offsets[:-1][rows], lengths[rows])
            self._sent[int(rank)] = chosen.astype(np.int32)
        self._received = {
            rank: _Addition(dof_map, blocks, layout.row_strides)
            for rank, blocks in enumerate(layout.received)
            if len(blocks.rows)
        }

    def add_to(self, arrays: Sequence[Array]) -> None:
        """Send the values, and add received ones to the matrix.

        Parameters
        ----------
        arrays : sequence of arrays
            The values of the diagonal block and, on several ranks, of the off-diagonal block.
        """
        requests = [self._comm.Irecv(a.values, source=r) for r, a in self._received.items()]
        messages = {rank: self.values[chosen] for rank, chosen in self._sent.items()}
        requests += [self._comm.Isend(values, dest=rank) for rank, values in messages.items()]
        MPI.Request.Waitall(requests)
        for addition in self._received.values():
            addition.add_to(arrays)


class _Addition:
    """Values received from one rank, and where they are added."""

    def __init__(self, dof_map: MixedDofMap, blocks: Received, strides: Sequence[Array]) -> None:
        begin = np.flatnonzero(np.diff(blocks.rows, prepend=-1))
        count = np.diff(begin, append=len(blocks.rows))
        size = dof_map.global_dofs(blocks.rows[begin])[1]
        # The blocks of each row of unknowns, and its number among those of its block row.
        block = concatenated_ranges(np.repeat(begin, size), np.repeat(count, size))
        number = concatenated_ranges(np.zeros_like(size), size)
        number = np.repeat(number, np.repeat(count, size))
        offset, array = np.divmod(blocks.positions, 4)
        own = blocks.rows - dof_map.owned_range[0]
        diagonal, off_diagonal = (strides[k][dof_map.is_owned][own] for k in range(2))
        first = offset[block] + number * np.where(array, off_diagonal, diagonal)[block]
        width = dof_map.global_dofs(blocks.columns)[1][block]
        target, array = concatenated_ranges(first, width), np.repeat(array[block], width)
        self.values = np.empty(len(target))
        chosen = [np.flatnonzero(array == k).astype(np.int32) for k in range(2)]
        self._parts = [(of, target[of].astype(np.int32)) for of in chosen]

    def add_to(self, arrays: Sequence[Array]) -> None:
        """Add the values to the arrays; every entry is there once."""
        for array, (chosen, target) in zip(arrays, self._parts, strict=True):
            array[target] += self.values[chosen]
