"""How the unknowns of several spaces are numbered together.

Unknowns come in blocks, one a node: 3 for a displacement, 1 for a pressure. Every rank numbers its
displacement nodes first, then those of the pressure if there is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Space:
    """One field's nodes on this rank.

    nodes : (cells, n) local node numbers; owned nodes come before ghosts.
    owned : how many nodes this rank owns.
    global_nodes : (owned + ghosts,) global number of each local node, contiguous on each rank.
    size : unknowns a node.
    """

    nodes: Array
    owned: int
    global_nodes: Array
    size: int


class Layout:
    """How the blocks of several spaces are numbered together, on all ranks. Collective.

    Attributes
    ----------
    nodes : (cells, sum of n) local blocks of each cell, one space after the other.
    sizes, numbers, owned : of each local block its unknowns, its global number, whether it is ours.
    unknowns : how many this rank owns; ``total`` blocks there are on all ranks.
    """

    def __init__(self, comm: Any, spaces: Sequence[Space]) -> None:
        self.comm, self.rank = comm, comm.rank
        counts = np.array(comm.allgather([s.owned for s in spaces]), dtype=np.int64)
        self._sizes = np.array([s.size for s in spaces])
        before = np.vstack([0 * counts[:1], np.cumsum(counts, axis=0)])  # (ranks + 1, spaces)
        self._blocks = before.sum(axis=1)
        self._first = self._blocks[:-1, None] + np.cumsum(counts, axis=1) - counts
        self._unknowns = (before * self._sizes).sum(axis=1)
        inside = np.cumsum(counts * self._sizes, axis=1) - counts * self._sizes
        self._first_unknown = self._unknowns[:-1, None] + inside
        self.total = int(self._blocks[-1])
        self.first, self.last = (int(b) for b in self._blocks[comm.rank : comm.rank + 2])
        self.unknowns = int(np.diff(self._unknowns)[comm.rank])
        numbers, offsets = [], np.cumsum([0, *(len(s.global_nodes) for s in spaces)])
        for k, space in enumerate(spaces):
            rank = np.searchsorted(before[:, k], space.global_nodes, side="right") - 1
            numbers.append(self._first[rank, k] + space.global_nodes - before[rank, k])
        self.numbers = np.concatenate(numbers)
        self.sizes = np.repeat(self._sizes, np.diff(offsets))
        mine = [np.arange(len(s.global_nodes)) < s.owned for s in spaces]
        self.owned = np.concatenate(mine)
        parts = [s.nodes + shift for s, shift in zip(spaces, offsets[:-1], strict=True)]
        self.nodes = np.concatenate(parts, axis=1)

    def owner(self, blocks: Array) -> Array:
        """The rank that owns each of these global blocks."""
        return np.searchsorted(self._blocks, blocks, side="right") - 1

    def place(self, blocks: Array) -> tuple[Array, Array]:
        """(first unknown, number of unknowns) of each of these global blocks."""
        rank = self.owner(blocks)
        space = (blocks[:, None] >= self._first[rank]).sum(axis=1) - 1
        size = self._sizes[space]
        return self._first_unknown[rank, space] + size * (blocks - self._first[rank, space]), size

    @property
    def block_size(self) -> int | None:
        """The unknowns of a block if it is the same for all."""
        return int(self._sizes[0]) if len(self._sizes) == 1 else None
