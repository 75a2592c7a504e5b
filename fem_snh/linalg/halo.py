"""The values of other ranks that a matrix's rows need, in single precision."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np


class Halo:
    """Fetches the values of nodes that other ranks own. Collective.

    Parameters
    ----------
    first : (ranks + 1,) the first node of each rank, and the end.
    nodes : those wanted here, in ascending order.

    `exchange` may be called as often as one likes, and only with the ranks that are neighbours.
    """

    def __init__(self, comm: MPI.Comm, first: np.ndarray, nodes: np.ndarray) -> None:
        owner = np.searchsorted(first, nodes, side="right") - 1
        wanted = comm.alltoall([nodes[owner == rank] for rank in range(comm.size)])
        given = [rank for rank, asked in enumerate(wanted) if len(asked)]
        taken = [int(rank) for rank in np.unique(owner)]
        self._here = np.concatenate([wanted[r] for r in given] or [nodes[:0]]) - first[comm.rank]
        self._sent = np.zeros((len(self._here), 3), np.float32)
        self.ghosts = np.zeros((len(nodes), 3), np.float32)
        to = [3 * len(wanted[rank]) for rank in given]
        of = [3 * int((owner == rank).sum()) for rank in taken]  # ghosts are sorted, so by owner
        self._comm = comm.Create_dist_graph_adjacent(taken, given)
        self._out = [self._sent, (to, None), MPI.FLOAT]
        self._in = [self.ghosts, (of, None), MPI.FLOAT]

    def exchange(self, values: np.ndarray) -> None:
        """Put others' part of ``values``, (3 rows,), into ``ghosts``."""
        np.take(values.reshape(-1, 3), self._here, axis=0, out=self._sent)
        self._comm.Neighbor_alltoallv(self._out, self._in)
