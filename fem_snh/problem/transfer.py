"""Interpolate the state of a problem on another mesh of the same body."""

from __future__ import annotations

from math import inf
from typing import Any

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
        self._comm, x = domain.comm, _dolfinx.geometry_x(domain)
        boxes = self._comm.allgather((x.min(axis=0, initial=inf), x.max(axis=0, initial=-inf)))
        asked = [((low <= points) & (points <= high)).all(axis=1) for low, high in boxes]
        best, rank = np.full(len(points), inf), np.zeros(len(points), dtype=np.int32)
        # First the ranks near a point, then all for points that are in no cell of these.
        for _ in range(2):
            sent = [np.flatnonzero(on_rank) for on_rank in asked]
            given, ends = self._exchanged([points[which] for which in sent])
            found = self._comm.alltoall(np.split(locate(domain, given)[2], ends))
            for number, (which, outside) in enumerate(zip(sent, found, strict=True)):
                closer = outside < best[which]
                best[which[closer]], rank[which[closer]] = outside[closer], number
            self.inside: Array = best <= _INSIDE
            best[~self.inside] = inf
            asked = [~self.inside] * self._comm.size
        self._order = np.argsort(rank, kind="stable")
        parts = np.split(self._order, np.cumsum(np.bincount(rank, minlength=len(boxes)))[:-1])
        given, self._ends = self._exchanged([points[which] for which in parts])
        self._cells, self._xi, _ = locate(domain, given)

    def _exchanged(self, parts: list[Array]) -> tuple[Array, Array]:
        """Send ``parts[i]`` to rank i; return all that are received, and where to split them."""
        received = self._comm.alltoall(parts)
        return np.concatenate(received), np.cumsum([len(part) for part in received])[:-1]

    def values(self, function: Any) -> Array:
        """Return a Lagrange function's values at this rank's points, (n, components). Collective.

        The function's ghosts must be current.
        """
        V = function.function_space
        nodal = function.x.array.reshape(-1, _dolfinx.num_components(V))
        values = np.empty((len(self._order), nodal.shape[1]))
        basis, dofs = _dolfinx.tabulate_values(V, self._xi), _dolfinx.node_dofs(V)[self._cells]
        given = np.einsum("pk,pki->pi", basis, nodal[dofs])
        values[self._order] = self._exchanged(np.split(given, self._ends))[0]
        return values
