"""Scalar measures of a body's state: reaction forces, volume ratio, smallest J."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.fem.boundary_conditions import group_nodes
from fem_snh.fem.mesh import Mesh

Array = npt.NDArray[Any]


class Reactions:
    """Sums of nodal forces over physical groups. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mesh : Mesh
        The mesh.
    groups : sequence of str or int
        Names or numbers of physical groups.

    Attributes
    ----------
    groups : list of str
        The groups, as the keys of the result.
    """

    def __init__(self, V: Any, mesh: Mesh, groups: Sequence[str | int]) -> None:
        self._comm = mesh.domain.comm
        self._owned = _dolfinx.num_nodes(V)[0]
        nodes = {str(key): group_nodes(V, mesh, key) for key in groups}
        self._nodes = {key: n[n < self._owned] for key, n in nodes.items()}
        self.groups = list(self._nodes)

    def sum(self, gradient: Array) -> dict[str, list[float]]:
        """Return the force [N] on each group. Collective.

        Parameters
        ----------
        gradient : (n,) array
            This rank's part of dE/du [N], whose first entries are the displacement's.
        """
        forces = gradient[: 3 * self._owned].reshape(-1, 3)
        local = np.array([forces[nodes].sum(axis=0) for nodes in self._nodes.values()])
        total = self._comm.allreduce(local)
        return dict(zip(self._nodes, total.tolist(), strict=True))


def body_measures(comm: MPI.Intracomm, cell_fields: dict[str, Array], u: Array) -> dict[str, float]:
    """Return measures of the whole body. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The communicator of the mesh.
    cell_fields : dict of arrays
        Volumes [m^3] and smallest J of this rank's cells.
    u : (n, 3) array
        Displacement [m] of this rank's nodes.

    Returns
    -------
    dict
        ``volume_ratio``, deformed over reference volume; ``min_J``, the smallest J at a quadrature
        point; ``max_u``, the largest nodal displacement [m].
    """
    max_u = float(np.sqrt((u**2).sum(axis=1).max(initial=0.0)))
    sums = np.array([cell_fields["deformed_volume"].sum(), cell_fields["volume"].sum()])
    deformed, volume = comm.allreduce(sums)
    min_J = float(cell_fields["min_J"].min(initial=np.inf))
    return {
        "volume_ratio": float(deformed / volume),
        "min_J": float(comm.allreduce(min_J, op=MPI.MIN)),
        "max_u": float(comm.allreduce(max_u, op=MPI.MAX)),
    }
