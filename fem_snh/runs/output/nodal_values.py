"""Gather nodal values on rank 0 with their reference coordinates, and scatter them again.

A checkpoint holds both, so that a run on another partition of the mesh finds its own nodes.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.errors import BadInput
from fem_snh.problem.problem import Problem

#: Largest distance between coordinates of the same node, relative to the body's extent. Partitions
#: compute coordinates that differ by rounding; different nodes are much farther apart.
_TOLERANCE = 1e-9


class NodalField:
    """Gathers and scatters the nodal values of one field of unknowns. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    V : dolfinx.fem.FunctionSpace
        The field's space.
    first : int
        Index of the field's first entry among the entries that this rank owns.
    size : int
        Number of components at each node.

    Attributes
    ----------
    nodes : (n, 3) array
        Reference coordinates [length] of all nodes on rank 0; (0, 3) on the other ranks.
    """

    def __init__(self, comm: MPI.Comm, V: _dolfinx.FunctionSpace, first: int, size: int) -> None:
        owned = _dolfinx.num_nodes(V)[0]
        self._comm, self._size = comm, size
        self._owned = slice(first, first + size * owned)
        self.nodes = gather_rows(comm, V.tabulate_dof_coordinates()[:owned])

    def gather(self, x: PETSc.Vec) -> Array:
        """Return the field's values in a vector of unknowns. Collective.

        Returns
        -------
        (n, size) array
            On rank 0, in the order of `nodes`; (0, size) on the other ranks.
        """
        return gather_rows(self._comm, x.array_r[self._owned].reshape(-1, self._size))

    def scatter(self, values: Array | None, x: PETSc.Vec) -> None:
        """Set the field's owned entries in a vector of unknowns. Collective.

        Parameters
        ----------
        values : (n, size) array or None
            The values in the order of `nodes`; only rank 0 needs them.
        x : PETSc.Vec
            The vector.
        """
        shape = (self._owned.stop - self._owned.start) // self._size, self._size
        x.array[self._owned] = scatter_rows(self._comm, values, shape).ravel()


def gather_rows(comm: MPI.Comm, values: Array) -> Array:
    """Return the rows (n, k) of all ranks on rank 0, and no rows on the other ranks. Collective."""
    counts = np.array(comm.allgather(len(values)))
    columns = values.shape[1]
    whole = np.empty((counts.sum() if comm.rank == 0 else 0, columns))
    received = None if comm.rank else [whole, counts * columns]
    comm.Gatherv(np.ascontiguousarray(values, dtype=float), received, root=0)
    return whole


def scatter_rows(comm: MPI.Comm, whole: Array | None, shape: tuple[int, ...]) -> Array:
    """Return this rank's rows, of this shape, of ``whole``, the rows of all ranks. Collective.

    Only rank 0 needs ``whole``.
    """
    counts = np.array(comm.allgather(shape[0])) * shape[1]
    rows = np.empty(shape)
    sent = None if comm.rank else [np.ascontiguousarray(whole, dtype=float), counts]
    comm.Scatterv(sent, rows, root=0)
    return rows


def fields(problem: Problem) -> dict[str, NodalField]:
    """Return the fields "u" and, in a mixed formulation, the pressure "p". Collective."""
    comm, owned = problem.comm, _dolfinx.num_nodes(problem.V)[0]
    components = problem.kinematics.components
    found = {"u": NodalField(comm, problem.V, 0, components)}
    if problem.saddle_point:
        found["p"] = NodalField(comm, problem.saddle_point.Q, components * owned, 1)
    return found


def match_nodes(nodes: Array, others: Array) -> Array:
    """Return for each of ``nodes`` the index of the node in ``others`` with its coordinates.

    Parameters
    ----------
    nodes, others : (n, 3) array
        Reference coordinates [length] of the same nodes in two orders.

    Returns
    -------
    (n,) array of int

    Raises
    ------
    BadInput
        If the nodes are not the same, or two nodes have the same coordinates.
    """
    if len(nodes) != len(others):
        raise BadInput(f"another mesh: it has {len(nodes)} nodes, the checkpoint {len(others)}")
    if np.array_equal(nodes, others):  # the same partition, even with coincident nodes
        return np.arange(len(nodes))
    distance = _TOLERANCE * float(np.ptp(others, axis=0).max())
    from scipy.spatial import cKDTree  # slow to import, and only needed to resume

    found = cKDTree(others).query(nodes, distance_upper_bound=distance)[1]
    if missing := np.count_nonzero(found == len(others)):
        raise BadInput(
            f"another mesh: {missing} of its {len(nodes)} nodes are not in the checkpoint"
        )
    if len(np.unique(found)) < len(found):
        raise BadInput(
            "some nodes have the same coordinates: expected the same number of ranks as before"
        )
    return np.asarray(found)
