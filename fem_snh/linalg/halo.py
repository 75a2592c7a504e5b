"""Halo exchange: receive the values of nodes that other ranks own, or add to them.

An iteration of the linear solvers exchanges once.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt


@lru_cache
def _node_type(itemsize: int, width: int) -> MPI.Datatype:
    """Return the type of a node's values: one for all exchanges, as MPI never frees it."""
    scalar = {4: MPI.FLOAT, 8: MPI.DOUBLE}[itemsize]
    return scalar.Create_contiguous(width).Commit()


class Halo:
    """Exchange of nodal values through a PETSc star forest (``PetscSF``). Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The ranks.
    first : (ranks + 1,)
        First global node of each rank, and the number of nodes.
    nodes : (ghosts,)
        Global numbers of the ghost nodes of this rank.
    width : int
        Number of values of a node.
    dtype : dtype
        Their type; default: single precision.

    Attributes
    ----------
    first, nodes : (ranks + 1,), (ghosts,)
        Those given.
    ghosts : (ghosts, width)
        The values received by the last `exchange`.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        first: np.ndarray,
        nodes: np.ndarray,
        width: int,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        self.first, self.nodes = first, nodes
        owner = np.searchsorted(first, nodes, side="right") - 1
        remote = np.column_stack([owner, nodes - first[owner]]).astype(PETSc.IntType)
        self._forest = PETSc.SF().create(comm)
        self._forest.setGraph(int(first[comm.rank + 1] - first[comm.rank]), None, remote)
        self.ghosts: npt.NDArray[Any] = np.zeros((len(nodes), width), dtype)
        self._node = _node_type(self.ghosts.itemsize, width)

    def exchange(self, values: np.ndarray) -> None:
        """Copy other ranks' ``values``, (width rows,), into ``ghosts``."""
        self._forest.bcastBegin(self._node, values, self.ghosts, MPI.REPLACE)
        self._forest.bcastEnd(self._node, values, self.ghosts, MPI.REPLACE)

    def add(self, ghosts: np.ndarray, values: np.ndarray) -> None:
        """Add other ranks' ``ghosts`` of this rank's nodes to its ``values``, (width rows,)."""
        self._forest.reduceBegin(self._node, ghosts, values, MPI.SUM)
        self._forest.reduceEnd(self._node, ghosts, values, MPI.SUM)
