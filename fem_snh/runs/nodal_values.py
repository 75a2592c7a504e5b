"""A vector as values at coordinates, which any other partition of the mesh can read."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fem_snh import _dolfinx
from fem_snh.errors import BadInput
from fem_snh.fem.problem import Problem

Array = npt.NDArray[Any]

#: Nodes are the same if they are this near, in parts of the body's extent.
_NEAR = 1e-9


class NodalField:
    """One unknown field of a problem: ``size`` values at each node. Collective.

    Attributes
    ----------
    nodes : (n, 3) reference coordinates of all ranks' nodes, on rank 0; (0, 3) on the others.
    """

    def __init__(self, comm: MPI.Comm, V: Any, first: int, size: int) -> None:
        """``first``: where the field begins in each rank's part of the vector."""
        owned = _dolfinx.num_nodes(V)[0]
        self._comm, self._size = comm, size
        self._mine = slice(first, first + size * owned)
        self._counts = np.array(comm.allgather(owned))
        self.nodes = self._gathered(V.tabulate_dof_coordinates()[:owned])

    def gather(self, x: PETSc.Vec) -> Array:
        """(n, size) on rank 0, in the order of `nodes`; (0, size) on the others."""
        return self._gathered(x.array_r[self._mine].reshape(-1, self._size))

    def scatter(self, values: Array | None, x: PETSc.Vec) -> None:
        """Put ``values`` (n, size) of rank 0, in the order of `nodes`, into x."""
        mine = np.empty(self._mine.stop - self._mine.start)
        counts = self._counts * self._size
        sent = None if self._comm.rank else [np.ascontiguousarray(values), counts]
        self._comm.Scatterv(sent, mine, root=0)
        x.array[self._mine] = mine

    def _gathered(self, values: Array) -> Array:
        columns = values.shape[1]
        whole = np.empty((self._counts.sum() if self._comm.rank == 0 else 0, columns))
        received = None if self._comm.rank else [whole, self._counts * columns]
        self._comm.Gatherv(np.ascontiguousarray(values), received, root=0)
        return whole


def fields(problem: Problem) -> dict[str, NodalField]:
    """ "u" and, where it is unknown, the pressure "p". Collective."""
    comm, owned = problem.comm, _dolfinx.num_nodes(problem.V)[0]
    found = {"u": NodalField(comm, problem.V, 0, 3)}
    if problem.saddle_point:
        found["p"] = NodalField(comm, problem.saddle_point.Q, 3 * owned, 1)
    return found


def match_nodes(nodes: Array, others: Array) -> Array:
    """For each of ``nodes`` (n, 3) the number of the one of ``others`` (n, 3) at its place.

    BadInput if they are not the same nodes, whatever their order.
    """
    if len(nodes) != len(others):
        raise BadInput(f"another mesh: it has {len(nodes)} nodes, the checkpoint {len(others)}")
    if np.array_equal(nodes, others):  # the same ranks; also where two nodes are at one place
        return np.arange(len(nodes))
    far = _NEAR * float(np.ptp(others, axis=0).max())
    found = cKDTree(others).query(nodes, distance_upper_bound=far)[1]
    if lost := np.count_nonzero(found == len(others)):
        raise BadInput(f"another mesh: {lost} of its {len(nodes)} nodes are not in the checkpoint")
    if len(np.unique(found)) < len(found):
        raise BadInput("some nodes are at one place: only the same number of ranks can go on")
    return np.asarray(found)
