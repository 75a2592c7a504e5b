"""Which subdomains' unknowns a rank holds: all of them, or its own and those next to them.

A coarse vector has the entries of each subdomain that the rank holds. `Replicated` is faster for
few subdomains: one sum over the ranks, and each rank solves for itself. `Distributed` needs no
memory for other ranks' subdomains, and exchanges with the neighbouring ranks alone.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.linalg.halo import Halo

Array = npt.NDArray[Any]


class Replicated:
    """Every rank holds all subdomains, the unknowns of the coarse matrix E. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The ranks whose contributions are added up.
    subdomains : int
        Number of subdomains on all ranks.

    Attributes
    ----------
    comm : MPI.Intracomm
        The ranks that share E; each of them has the rows of other subdomains.
    held : (n,)
        Number, among all of them, of each subdomain that this rank holds.
    own : int
        How many of them, the first, are rows of E on this rank.
    """

    def __init__(self, comm: MPI.Intracomm, subdomains: int) -> None:
        self._ranks, self.comm = comm, MPI.COMM_SELF
        self.held: Array = np.arange(subdomains)
        self.own = subdomains

    def local(self, subdomain: Array) -> Array:
        """Return the positions in ``held`` of subdomains."""
        return subdomain

    def gather(self, blocks: Array) -> Array:
        """Return the blocks of the rows of E on this rank, from those that each rank computes."""
        counts, entries = self._ranks.allgather(len(blocks)), int(np.prod(blocks.shape[1:]))
        gathered = np.empty((sum(counts), *blocks.shape[1:]), blocks.dtype)
        self._ranks.Allgatherv(blocks, [gathered, [entries * count for count in counts]])
        return gathered

    def add(self, y: Array) -> None:
        """Replace the entries of the rows on this rank by the sum over all ranks, in place."""
        if self._ranks.size > 1:
            self._ranks.Allreduce(MPI.IN_PLACE, y)

    def extend(self, own: Array) -> Array:
        """Return ``own``, the entries of the rows on this rank, followed by those of the others."""
        return own


class Distributed:
    """Every rank holds its subdomains and those of its ghost nodes: see `Replicated`. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The ranks.
    counts : (ranks,)
        Number of subdomains of each rank.
    ghosts : (n,)
        Subdomains of this rank's ghost nodes, in any order.
    columns : int
        Entries of a coarse vector for a subdomain.
    """

    def __init__(self, comm: MPI.Intracomm, counts: Array, ghosts: Array, columns: int) -> None:
        self.comm, self.own = comm, int(counts[comm.rank])
        first = np.concatenate([[0], np.cumsum(counts)])
        self._first, self._ghosts = int(first[comm.rank]), np.unique(ghosts)
        self.held: Array = np.concatenate([self._first + np.arange(self.own), self._ghosts])
        self._halo = Halo(comm, first, self._ghosts, columns, np.float64)
        self._end = self.own * columns

    def local(self, subdomain: Array) -> Array:
        """See `Replicated`."""
        mine = subdomain - self._first
        of_others = self.own + np.searchsorted(self._ghosts, subdomain)
        return np.where((mine >= 0) & (mine < self.own), mine, of_others)

    def gather(self, blocks: Array) -> Array:
        """See `Replicated`."""
        return blocks.copy()

    def add(self, y: Array) -> None:
        """See `Replicated`."""
        flat = y.reshape(-1)
        self._halo.add(flat[self._end :], flat[: self._end])

    def extend(self, own: Array) -> Array:
        """See `Replicated`."""
        self._halo.exchange(own)
        return np.concatenate([own, self._halo.ghosts.ravel()])
