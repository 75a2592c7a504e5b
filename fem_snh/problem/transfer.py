"""Interpolate the state of a problem on another mesh of the same body."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fem_snh import _dolfinx
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]

#: Cells that are searched for a point, those with the nearest centres first; then larger ones.
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
    x, points = x[..., :dim], points[:, :dim]
    centres, count = x.mean(axis=1), min(_CANDIDATES, len(x))
    distances, nearest = (
        found.reshape(-1, count) for found in cKDTree(centres).query(points, count)
    )
    low, high = x.min(axis=1), x.max(axis=1)
    margin = _MARGIN * (high - low).max(axis=1, keepdims=True)  # thin cells may be bent by more
    low, high = low - margin, high + margin
    simplex = _dolfinx.cell_name(domain) in ("tetrahedron", "triangle")
    start = np.full(dim, 1 / (dim + 1) if simplex else 0.5)

    def search(rest: Array, candidates: Array) -> None:
        """Search a candidate for each point of ``rest`` that is in no cell so far."""
        left = outside[rest] > _INSIDE
        rest, candidates = rest[left], candidates[left]
        at = points[rest]
        near = ((at >= low[candidates]) & (at <= high[candidates])).all(axis=1)
        near |= np.isinf(outside[rest])
        rest, candidates = rest[near], candidates[near]
        if not len(rest):
            return
        xi = _reference_coordinates(domain, x[candidates], points[rest], start)
        upper = xi.sum(axis=1) if simplex else xi.max(axis=1)
        distance = np.maximum(-xi.min(axis=1), upper - 1)
        better = distance < outside[rest]
        chosen = rest[better]
        cells[chosen], best[chosen] = candidates[better], xi[better]
        outside[chosen] = distance[better]

    for candidates in nearest.T:
        search(np.arange(len(points)), candidates)
    if count < len(x):
        rest = np.flatnonzero(outside > _INSIDE)
        for chosen, candidates in _larger_cells(
            x - centres[:, None], centres, points[rest], distances[rest, -1]
        ):
            search(rest[chosen], candidates)
    return cells, best, outside


def _larger_cells(
    arms: Array, centres: Array, points: Array, distances: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield points and a cell for each, whose centre is farther than a distance, not its nodes.

    Beside small cells a point in a large one has many centres that are nearer than that of its own.

    Parameters
    ----------
    arms, centres : (cells, nodes, dim), (cells, dim)
        The nodes less the centre of each cell, and the centres.
    points, distances : (n, dim), (n,)
        The points, and the distances within which all centres have been searched.
    """
    radii = np.linalg.norm(arms, axis=2).max(axis=1)
    rest = np.flatnonzero(distances < radii.max())
    if not len(rest):
        return
    large = np.flatnonzero(radii > distances[rest].min())
    found = cKDTree(points[rest]).query_ball_point(centres[large], radii[large])
    number = np.repeat(large, [len(members) for members in found])
    member = rest[np.concatenate(found).astype(np.int64)]
    farther = np.linalg.norm(points[member] - centres[number], axis=1) > distances[member]
    number, member = number[farther], member[farther]
    order = np.argsort(member, kind="stable")
    number, member = number[order], member[order]
    turn = np.arange(len(member)) - np.searchsorted(member, member)
    for k in range(turn.max(initial=-1) + 1):
        yield member[turn == k], number[turn == k]


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
