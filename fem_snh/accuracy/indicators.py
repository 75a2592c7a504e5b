r"""Where the error is: the estimate of a goal, distributed to the cells.

To first order the error of a goal is

.. math:: Q(u) - Q(u_h) \approx -\sum_n r_n \cdot z_n,

with the residual r of the run's solution in the lifted problem, the dual solution z, and the nodes
n of the lifted element (Becker & Rannacher 2001). The run's solution is orthogonal to its own
space, so z less its interpolation there has all of the sum. Each node's product is shared equally
by its cells, as by a partition of unity (Richter & Wick 2015): no stresses jump between cells.
What the interpolation leaves, as the two elements treat volumes differently, is distributed in the
same way by the nodes of the run's element, so that the sum over all cells is exact.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import chain

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.accuracy.differences import Lift
from fem_snh.accuracy.goal_errors import Place
from fem_snh.arrays import Array
from fem_snh.assembly.unknowns import summed_over_cells, with_ghosts
from fem_snh.mesh.mesh import Mesh
from fem_snh.problem.duals import Linearisation
from fem_snh.problem.goals import Goal, TermGoal
from fem_snh.problem.problem import Problem


def cell_indicators(lift: Lift, goals: Sequence[Goal], chosen: Collection[str]) -> dict[str, Array]:
    """Return the error of each chosen goal in each cell of this rank, by name. Collective.

    Goals whose dual problem the linear solver does not solve are missing.

    Parameters
    ----------
    lift : Lift
        The lifted problem at its solution.
    goals : sequence of Goal
        The goals.
    chosen : collection of str
        The names of the goals whose errors are wanted.
    """
    found: dict[str, Array] = {}
    if not chosen:
        return found
    problem, lifted, solve = lift.problem, lift.lifted, lift.dual_solver()
    at = Linearisation(lifted, lifted.x - lift.start, solve)
    shares = Shares(problem, lifted, lift.start_gradient)
    for goal in goals:
        for number, name in enumerate(goal.names):
            if name not in chosen:
                continue
            (z,) = at.solutions([goal.dual(at, number)])
            if not np.isfinite(z.norm()):
                continue
            found[name] = -shares.of(z)
            if isinstance(goal, TermGoal):
                nodal = goal.nodal(lifted, lift.start, number)
                found[name] += shares.of_forces(nodal, goal.nodal(problem, problem.x, number))
    lift.linear += solve.iterations
    return found


class Shares:
    """Distributes products with the residual of a solution in the lifted problem. Collective.

    Parameters
    ----------
    problem, lifted : Problem
        A problem at its solution, and the same in another element on the same cells.
    gradient : PETSc.Vec
        The gradient of the lifted problem's energy at that solution.
    """

    def __init__(self, problem: Problem, lifted: Problem, gradient: PETSc.Vec) -> None:
        cell, degree, low = lifted.element.cell, lifted.element.degree, problem.element.degree
        nodes = _dolfinx.reference_nodes(cell, degree)
        coarse = _dolfinx.reference_nodes(cell, low)
        #: From values at the lifted nodes to those at the run's, and back.
        self._down = _dolfinx.tabulate_element(cell, degree, coarse, 0)[0]
        self._up = _dolfinx.tabulate_element(cell, low, nodes, 0)[0]
        self._V, self._spaces, self._size = problem.V, [lifted.V], lifted.owned_displacements
        if lifted.saddle_point:
            self._spaces.append(lifted.saddle_point.Q)
        parts = zip(self._spaces, self._parts(gradient), strict=True)
        self._residual = [_shared(V, part) for V, part in parts]
        own = problem.gradient_at(problem.x)
        self._coarse = self._less(self._residual[0], own.array_r[: problem.owned_displacements])

    def of(self, z: PETSc.Vec) -> Array:
        """Return the share of each cell of this rank in the product with z."""
        displacement, *pressure = self._parts(z)
        coarse = self._down @ displacement
        factors = (displacement - self._up @ coarse, *pressure, coarse)
        pairs = zip((*self._residual, self._coarse), factors, strict=True)
        return np.asarray(sum((r * factor).sum(axis=(1, 2)) for r, factor in pairs))

    def of_forces(self, lifted: PETSc.Vec | None, of_run: PETSc.Vec | None) -> Array | float:
        """Return the share of each cell in the sum of the lifted nodal forces less the run's.

        They are at the nodes of the run's element, where forces at one state differ least.
        """
        if lifted is None or of_run is None:
            return 0.0
        V = self._spaces[0]
        shared = _shared(V, _at_nodes(V, lifted.array_r))
        return np.asarray(self._less(shared, of_run.array_r).sum(axis=(1, 2)))

    def _less(self, lifted: Array, of_run: Array) -> Array:
        """Return the lifted element's forces at the run's nodes, less the run's, in cells.

        The first are (cells, nodes, components), shared by the cells; the second owned dofs.
        """
        summed = _summed(self._V, self._up.T @ lifted)
        return _shared(self._V, summed - _at_nodes(self._V, of_run))

    def _parts(self, x: PETSc.Vec) -> list[Array]:
        """Return a vector's displacements, (cells, nodes, components), then its pressures."""
        fields = zip(self._spaces, np.split(x.array_r, [self._size]), strict=False)
        return [_at_nodes(V, owned) for V, owned in fields]


def _at_nodes(V: _dolfinx.FunctionSpace, owned: Array) -> Array:
    """Return owned dofs at the nodes of each cell, (cells, nodes, components). Collective."""
    values = with_ghosts(V, owned).reshape(-1, _dolfinx.num_components(V))
    return np.array(values[_dolfinx.node_dofs(V)])


def _summed(V: _dolfinx.FunctionSpace, values: Array) -> Array:
    """Return the sums over cells of values at their nodes, at the nodes of each cell."""
    return np.asarray(summed_over_cells(V, values)[_dolfinx.node_dofs(V)])


def _shared(V: _dolfinx.FunctionSpace, values: Array) -> Array:
    """Return values at the nodes of each cell over the number of cells around each. Collective."""
    return np.asarray(values / _summed(V, np.ones((*values.shape[:2], 1))))


def place(problem: Problem, indicators: Array, mesh: Mesh | None = None) -> Place | None:
    """Return the fewest cells that have half of the sum of the indicators' sizes. Collective.

    None if all indicators are zero.

    Parameters
    ----------
    problem : Problem
        The problem, of whose mesh the cells are.
    indicators : (owned cells,) array
        The indicators.
    mesh : Mesh, optional
        The mesh, whose groups are named.
    """
    domain, comm = problem.domain, problem.comm
    sizes = np.abs(indicators)
    x = _dolfinx.geometry_x(domain)[:, : problem.kinematics.dim]
    centres = x[_dolfinx.geometry_dofs(domain)].mean(axis=1)
    total, number = comm.allreduce(np.array([sizes.sum(), len(sizes)]))
    if not total > 0:
        return None
    # Numbers that are not negative are in the order of their bits: bisection, to the last bit.
    bits, limit = sizes.view(np.int64), 0
    for bit in reversed(range(63)):
        if comm.allreduce(sizes[bits >= limit + 2**bit].sum()) >= total / 2:
            limit += 2**bit
    weights = np.where(bits >= limit, sizes, 0.0)
    weight, cells = comm.allreduce(np.array([weights.sum(), (bits >= limit).sum()]))
    most = comm.allreduce(sizes.max(initial=0.0), MPI.MAX)
    at_largest = [tuple(float(x) for x in centres[k]) for k in np.flatnonzero(sizes == most)]
    largest = min(chain.from_iterable(comm.allgather(at_largest)))
    group = _nearest_group(mesh, weights, int(number)) if mesh else ""
    return Place(float(weight / total), int(cells), int(number), largest, group)


def _nearest_group(mesh: Mesh, weights: Array, num_cells: int) -> str:
    """Return the smallest group that cells with most of the weight touch; "" for none."""
    domain, comm = mesh.domain, mesh.domain.comm
    total, best = comm.allreduce(weights.sum()), ("", num_cells / 2)
    corners = _dolfinx.input_vertices(domain, domain.topology.dim)[: len(weights)]
    for group in mesh.groups:
        if group.dim == mesh.dim or not group.count:
            continue
        nodes = _dolfinx.input_vertices(domain, group.dim)[group.entities]
        every = np.unique(np.concatenate(comm.allgather(nodes.ravel())))
        touching = np.isin(corners, every).any(axis=1)
        weight, cells = comm.allreduce(np.array([weights[touching].sum(), touching.sum()]))
        if weight > total / 2 and cells < best[1]:
            best = group.name, cells
    return best[0]
