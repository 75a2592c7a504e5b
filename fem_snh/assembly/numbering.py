"""Dof maps: how the unknowns of one or two finite element spaces are numbered in a matrix.

As in dolfinx, unknowns are numbered in blocks, one block per node: the displacement's
components, or 1 pressure. Every rank numbers its displacement blocks first, then its pressure
blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class DofMap:
    """The blocked dof map of one space on this rank.

    Attributes
    ----------
    cell_blocks : (cells, n) int32
        Local block numbers of each cell; the blocks this rank owns come before ghosts.
    num_owned : int
        Blocks this rank owns.
    local_to_global : (owned + ghosts,) int64
        Global number of each local block, contiguous on each rank.
    block_size : int
        Unknowns per block.
    """

    cell_blocks: Array
    num_owned: int
    local_to_global: Array
    block_size: int


def dof_map(V: Any) -> DofMap:
    """Return the dof map of a dolfinx space."""
    return DofMap(
        _dolfinx.node_dofs(V),
        _dolfinx.num_nodes(V)[0],
        _dolfinx.local_to_global(V),
        _dolfinx.num_components(V),
    )


class MixedDofMap:
    """The dof maps of several spaces, numbered together on all ranks. Collective.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
        The communicator of the mesh.
    spaces : sequence of DofMap
        The spaces, in the order in which each rank numbers them.

    Attributes
    ----------
    cell_blocks : (cells, sum of n) int
        Local blocks of each cell, one space after the other.
    block_sizes, local_to_global, is_owned : (local blocks,)
        Unknowns, global block number and ownership of each local block.
    owned_range : tuple of int
        First global block of this rank, and one past its last.
    num_owned_dofs : int
        Unknowns this rank owns.
    num_blocks, num_owned_blocks, num_cell_blocks : list of int
        For each space, the blocks on this rank with ghosts, those it owns, and those of a cell.
    """

    def __init__(self, comm: Any, spaces: Sequence[DofMap]) -> None:
        self.comm = comm
        self.num_blocks = [len(s.local_to_global) for s in spaces]
        self.num_owned_blocks = [s.num_owned for s in spaces]
        self.num_cell_blocks = [s.cell_blocks.shape[1] for s in spaces]
        counts = np.array(comm.allgather([s.num_owned for s in spaces]), dtype=np.int64)
        self._space_block_size = np.array([s.block_size for s in spaces])
        before = np.vstack([0 * counts[:1], np.cumsum(counts, axis=0)])  # (ranks + 1, spaces)
        self._nodes_before = before[:, 0]
        self._first_block = before.sum(axis=1)
        self._first = self._first_block[:-1, None] + np.cumsum(counts, axis=1) - counts
        dof_counts = counts * self._space_block_size
        first_dof = (before * self._space_block_size).sum(axis=1)
        self._first_dof = first_dof[:-1, None] + np.cumsum(dof_counts, axis=1) - dof_counts
        self.owned_range = tuple(int(b) for b in self._first_block[comm.rank : comm.rank + 2])
        self.num_owned_dofs = int(np.diff(first_dof)[comm.rank])

        global_blocks, offsets = [], np.cumsum([0, *(len(s.local_to_global) for s in spaces)])
        for k, space in enumerate(spaces):
            rank = np.searchsorted(before[:, k], space.local_to_global, side="right") - 1
            global_blocks.append(self._first[rank, k] + space.local_to_global - before[rank, k])
        self.local_to_global = np.concatenate(global_blocks)
        self.block_sizes = np.repeat(self._space_block_size, np.diff(offsets))
        owned = [np.arange(len(s.local_to_global)) < s.num_owned for s in spaces]
        self.is_owned = np.concatenate(owned)
        cells = [s.cell_blocks + shift for s, shift in zip(spaces, offsets[:-1], strict=True)]
        self.cell_blocks = np.concatenate(cells, axis=1)

    def displacement_blocks(self, nodes: Array) -> Array:
        """Return the global blocks of global nodes of the first space."""
        rank = np.searchsorted(self._nodes_before, nodes, side="right") - 1
        return self._first[rank, 0] + nodes - self._nodes_before[rank]

    def owner_ranks(self, blocks: Array) -> Array:
        """Return the rank that owns each of these global blocks."""
        return np.searchsorted(self._first_block, blocks, side="right") - 1

    def global_dofs(self, blocks: Array) -> tuple[Array, Array]:
        """Return (first global dof, block size) of each of these global blocks."""
        rank = self.owner_ranks(blocks)
        space = (blocks[:, None] >= self._first[rank]).sum(axis=1) - 1
        size = self._space_block_size[space]
        return self._first_dof[rank, space] + size * (blocks - self._first[rank, space]), size

    def blocks_of(self, dofs: Array) -> Array:
        """Return the global blocks of these global dofs."""
        rank = np.searchsorted(self._first_dof[:, 0], dofs, side="right") - 1
        space = (dofs[:, None] >= self._first_dof[rank]).sum(axis=1) - 1
        offset = (dofs - self._first_dof[rank, space]) // self._space_block_size[space]
        return np.asarray(self._first[rank, space] + offset)

    @property
    def components(self) -> int:
        """The unknowns of a block of the first space: the displacement's components."""
        return int(self._space_block_size[0])

    @property
    def cell_block_sizes(self) -> Array:
        """(sum of n,) unknowns of each block of a cell."""
        return np.repeat(self._space_block_size, self.num_cell_blocks)

    @property
    def block_size(self) -> int | None:
        """The block size, if all spaces have the same; else None."""
        sizes = self._space_block_size
        return int(sizes[0]) if len(sizes) == 1 else None
