"""Interpolate the state of a problem on another mesh of the same body."""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.cell_search import locate
from fem_snh.problem.problem import Problem

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


class _Round(NamedTuple):
    """Points that ranks located for each other.

    Attributes
    ----------
    sent, closer : list of arrays
        For each rank: the points that it located for this one, and in which of them its cell was
        nearer than those of the ranks before.
    ends : (ranks - 1,) int
        Where to split the points that this rank located into those of each rank.
    cells, xi : (n,), (n, dim)
        The nearest cells of this rank, and the points' reference coordinates in them.
    """

    sent: list[Array]
    closer: list[Array]
    ends: Array
    cells: Array
    xi: Array


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
        self._comm, x = domain.comm, _dolfinx.geometry_x(domain)
        boxes = self._comm.allgather((x.min(axis=0, initial=inf), x.max(axis=0, initial=-inf)))
        asked = [((low <= points) & (points <= high)).all(axis=1) for low, high in boxes]
        best, self._rounds = np.full(len(points), inf), list[_Round]()
        # First the ranks near a point, then all for points that are in no cell of these.
        for _ in range(2):
            sent = [np.flatnonzero(on_rank) for on_rank in asked]
            given = self._comm.alltoall([points[which] for which in sent])
            ends = np.cumsum([len(part) for part in given])[:-1]
            cells, xi, outside = locate(domain, np.concatenate(given))
            found, closer = self._comm.alltoall(np.split(outside, ends)), list[Array]()
            for which, distance in zip(sent, found, strict=True):
                closer.append(distance < best[which])
                best[which[closer[-1]]] = distance[closer[-1]]
            self._rounds.append(_Round(sent, closer, ends, cells, xi))
            self.inside: Array = best <= _INSIDE
            if self._comm.allreduce(bool(self.inside.all()), MPI.LAND):
                break
            best[~self.inside] = inf
            asked = [~self.inside] * self._comm.size

    def values(self, function: Any) -> Array:
        """Return a Lagrange function's values at this rank's points, (n, components). Collective.

        The function's ghosts must be current.
        """
        V = function.function_space
        nodal = function.x.array.reshape(-1, _dolfinx.num_components(V))
        values = np.empty((len(self.inside), nodal.shape[1]))
        for sent, closer, ends, cells, xi in self._rounds:
            basis, dofs = _dolfinx.tabulate_values(V, xi), _dolfinx.node_dofs(V)[cells]
            given = np.einsum("pk,pki->pi", basis, nodal[dofs])
            parts = self._comm.alltoall(np.split(given, ends))
            for which, is_closer, part in zip(sent, closer, parts, strict=True):
                values[which[is_closer]] = part[is_closer]
        return values
