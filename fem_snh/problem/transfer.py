"""Interpolate the state of a problem on another mesh of the same body."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fem_snh import _dolfinx
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]

#: Cells that are searched for a point, those with the nearest centres first.
_CANDIDATES = 24
#: Cells whose boxes, larger on each side by this part of the longest one, do not have a point are
#: no better for it than the one with the nearest centre.
_MARGIN = 0.25
#: A point so far outside of the reference cell is in the cell, within rounding.
_INSIDE = 1e-8
#: Newton iterations for the coordinates in a reference cell; one suffices for tetrahedra.
_NEWTON = 6
#: A change of these coordinates after which they are found.
_SETTLED = 1e-12


def transfer_state(source: Problem, target: Problem) -> None:
    """Set ``target.x`` to the state of ``source``, interpolated. Collective.

    Points outside of the source's mesh, which a curved surface has, have the values that the
    polynomials of the nearest cell have there. An unknown pressure is transferred if both problems
    have one of the same kind; otherwise it is zero.
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
    """Return the values (n, components) of a Lagrange function at points of any rank. Collective.

    The parameters are those of `LocatedPoints` and of `LocatedPoints.values`.
    """
    return LocatedPoints(function.function_space.mesh, points).values(function)


class LocatedPoints:
    """Points of any rank with the cells that they are in, or are nearest to. Collective.

    Parameters
    ----------
    domain : dolfinx mesh
        The mesh.
    points : (n, 3)
        This rank's points [length].

    Attributes
    ----------
    inside : (n,) bool
        Which of this rank's points are in a cell.
    """

    def __init__(self, domain: Any, points: Array) -> None:
        self._comm = comm = domain.comm
        counts = comm.allgather(len(points))
        first = sum(counts[: comm.rank])
        self._own, self._count = slice(first, first + len(points)), sum(counts)
        cells, xi, outside = _locate(domain, np.concatenate(comm.allgather(points)))
        best, rank = outside.copy(), np.empty(self._count, dtype=np.int32)
        comm.Allreduce(MPI.IN_PLACE, best, op=MPI.MIN)
        rank[:] = np.where(outside == best, comm.rank, comm.size)
        comm.Allreduce(MPI.IN_PLACE, rank, op=MPI.MIN)
        self._mine = np.flatnonzero(rank == comm.rank)
        self._cells, self._xi = cells[self._mine], xi[self._mine]
        self.inside: Array = best[self._own] <= _INSIDE

    def values(self, function: Any) -> Array:
        """Return a Lagrange function, with ghosts, at this rank's points, (n, components)."""
        V = function.function_space
        nodal = function.x.array.reshape(-1, _dolfinx.num_components(V))
        values = np.zeros((self._count, nodal.shape[1]))
        if len(self._mine):
            basis = _dolfinx.tabulate_values(V, self._xi)
            dofs = _dolfinx.node_dofs(V)[self._cells]
            values[self._mine] = np.einsum("pk,pki->pi", basis, nodal[dofs])
        self._comm.Allreduce(MPI.IN_PLACE, values, op=MPI.SUM)
        return values[self._own]


def _locate(domain: Any, points: Array) -> tuple[Array, Array, Array]:
    """Return this rank's cell of each point or the nearest one, its coordinates there, the excess.

    The excess is the distance from the reference cell, <= 0 inside; infinite without cells.
    """
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)]
    cells, outside = np.zeros(len(points), dtype=np.int64), np.full(len(points), np.inf)
    dim = _dolfinx.mesh_dimension(domain)[0]
    best = np.zeros((len(points), dim))
    if not len(x) or not len(points):
        return cells, best, outside
    x = x[..., :dim]
    count = min(_CANDIDATES, len(x))
    nearest = cKDTree(x.mean(axis=1)).query(points[:, :dim], count)[1].reshape(-1, count)
    low, high = x.min(axis=1), x.max(axis=1)
    margin = _MARGIN * (high - low).max(axis=1, keepdims=True)  # thin cells may be bent by more
    low, high = low - margin, high + margin
    simplex = _dolfinx.cell_name(domain) in ("tetrahedron", "triangle")
    start = np.full(dim, 1 / (dim + 1) if simplex else 0.5)
    for candidate in nearest.T:
        rest = np.flatnonzero(outside > _INSIDE)
        if not len(rest):
            break
        at, cell = points[rest, :dim], candidate[rest]
        near = ((at >= low[cell]) & (at <= high[cell])).all(axis=1)
        rest = rest[near | np.isinf(outside[rest])]
        if not len(rest):
            continue
        xi = _reference_coordinates(domain, x[candidate[rest]], points[rest, :dim], start)
        upper = xi.sum(axis=1) if simplex else xi.max(axis=1)
        distance = np.maximum(-xi.min(axis=1), upper - 1)
        better = distance < outside[rest]
        chosen = rest[better]
        cells[chosen], best[chosen] = candidate[chosen], xi[better]
        outside[chosen] = distance[better]
    return cells, best, outside


def _reference_coordinates(domain: Any, nodes: Array, points: Array, start: Array) -> Array:
    """Return where each point is in the reference cell of its cell, (n, dim), by Newton's method.

    ``nodes`` (n, nodes of a cell, dim) are those of the points' cells; all begin at ``start``.
    """
    kind, degree = _dolfinx.cell_name(domain), _dolfinx.geometry_degree(domain)
    xi = np.tile(start, (len(points), 1))
    rest = np.arange(len(points))
    for _ in range(_NEWTON):
        basis, *derivatives = _dolfinx.tabulate_element(kind, degree, xi[rest], 1)
        excess = points[rest] - np.einsum("pk,pki->pi", basis, nodes[rest])
        jacobians = nodes[rest].transpose(0, 2, 1) @ np.stack(derivatives, axis=-1)
        before = xi[rest]
        after = before + np.linalg.solve(jacobians, excess[..., None])[..., 0]
        xi[rest] = np.clip(after, -1.0, 2.0)  # far outside, Newton's method may diverge
        rest = rest[(np.abs(xi[rest] - before) > _SETTLED).any(axis=1)]
        if not len(rest):
            break
    return xi
