"""Halo exchange: receive the values of nodes that other ranks own, in single precision.

An iteration of the linear solver exchanges once.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np


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

    Attributes
    ----------
    ghosts : (ghosts, 3) float32
        The values received by the last `exchange`.
    """

    def __init__(self, comm: MPI.Comm, first: np.ndarray, nodes: np.ndarray) -> None:
        owner = np.searchsorted(first, nodes, side="right") - 1
        remote = np.column_stack([owner, nodes - first[owner]]).astype(PETSc.IntType)
        self._forest = PETSc.SF().create(comm)
        self._forest.setGraph(int(first[comm.rank + 1] - first[comm.rank]), None, remote)
        self._node = MPI.FLOAT.Create_contiguous(3).Commit()
        self.ghosts = np.zeros((len(nodes), 3), np.float32)

    def exchange(self, values: np.ndarray) -> None:
        """Copy other ranks' ``values``, (3 rows,) float32, into ``ghosts``."""
        self._forest.bcastBegin(self._node, values, self.ghosts, MPI.REPLACE)
        self._forest.bcastEnd(self._node, values, self.ghosts, MPI.REPLACE)
