"""Interpolate the state of a problem on another mesh of the same body."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.cell_search import locate
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]

#: Distance outside of the reference cell up to which a point counts as inside.
_INSIDE = 1e-8


def transfer_state(source: Problem, target: Problem) -> None:
    """Set ``target.x`` to the state of ``source``, interpolated. Collective.

    At points outside of the source's mesh, as beside a curved surface, the polynomials of the
    nearest cell are extrapolated. An unknown pressure is transferred if both problems have
    continuous pressures; otherwise it is zero.
    """
    source.split(source.x)
    size = target.owned_displacements
    components = size // max(1, len(target.coordinates))
    target.x.set(0.0)
    u = evaluate(source.u, target.coordinates)
    target.x.array[:size] = u[:, :components].ravel()
    ours, theirs = source.saddle_point, target.saddle_point
    if ours is not None and theirs is not None:
        if not (ours.cell_pressures or theirs.cell_pressures):
            pressure = _dolfinx.function(ours.Q, "pressure")
            pressure.x.array[:] = ours.pressure()
            dofs = theirs.pressure_dofs(target.x)
            points = theirs.Q.tabulate_dof_coordinates()[: len(dofs)]
            dofs[:] = evaluate(pressure, points)[:, 0] / theirs.unit


def evaluate(function: Any, points: Array) -> Array:
    """Return the values (n, components) of a Lagrange function at points. Collective.

    ``points`` and ``function``: see `LocatedPoints` and `LocatedPoints.values`.
    """
    return LocatedPoints(function.function_space.mesh, points).values(function)


class LocatedPoints:
    """Points, each with the cell of any rank that contains it or is nearest to it. Collective.

    Parameters
    ----------
    domain : dolfinx mesh
        The mesh.
    points : (n, 3)
        This rank's points [length]; they may lie in cells of other ranks.

    Attributes
    ----------
    inside : (n,) bool
        Which of this rank's points are in a cell.
    """

    def __init__(self, domain: _dolfinx.Mesh, points: Array) -> None:
        self._comm = comm = domain.comm
        counts = comm.allgather(len(points))
        first = sum(counts[: comm.rank])
        self._own, self._count = slice(first, first + len(points)), sum(counts)
        cells, xi, outside = locate(domain, np.concatenate(comm.allgather(points)))
        best, rank = outside.copy(), np.empty(self._count, dtype=np.int32)
        comm.Allreduce(MPI.IN_PLACE, best, op=MPI.MIN)
        rank[:] = np.where(outside == best, comm.rank, comm.size)
        comm.Allreduce(MPI.IN_PLACE, rank, op=MPI.MIN)
        self._mine = np.flatnonzero(rank == comm.rank)
        self._cells, self._xi = cells[self._mine], xi[self._mine]
        self.inside: Array = best[self._own] <= _INSIDE

    def values(self, function: Any) -> Array:
        """Return a Lagrange function's values at this rank's points, (n, components). Collective.

        The function's ghosts must be current.
        """
        V = function.function_space
        nodal = function.x.array.reshape(-1, _dolfinx.num_components(V))
        values = np.zeros((self._count, nodal.shape[1]))
        if len(self._mine):
            basis = _dolfinx.tabulate_values(V, self._xi)
            dofs = _dolfinx.node_dofs(V)[self._cells]
            values[self._mine] = np.einsum("pk,pki->pi", basis, nodal[dofs])
        self._comm.Allreduce(MPI.IN_PLACE, values, op=MPI.SUM)
        return values[self._own]
