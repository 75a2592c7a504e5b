r"""The differences of goals between a run and its lifted problem, which Newton iterations find.

How much of the error the lifted solution leaves follows from the decay of its own degrees. The
error of an element of degree p on a given mesh decreases as :math:`C p^{-\beta}` where the solution
is singular (Babuska & Suri 1987), and faster where it is smooth. A lifted solution of degree 3 has
the parts of degree 2 and 3 in each cell, of squares

.. math:: a_k = \int_K \lvert \nabla (I_k u_+ - I_{k-1} u_+) \rvert^2 \, \mathrm{d}V,

with the nodal interpolations I_k of degree k. Their ratio gives the cell's :math:`\beta`, and so
the sum of all further parts. The estimate is multiplied by the sum of the parts from degree 3 on,
over all cells, divided by that of degree 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import log

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.accuracy.goal_errors import Estimate, NoEstimate
from fem_snh.accuracy.lift import Lift
from fem_snh.assembly.unknowns import local_values
from fem_snh.problem.goals import Goal, bind_all, names_of, slices_of
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import is_at_rest

Array = npt.NDArray[np.float64]

#: Part of a difference that may be unsettled.
SETTLED = 0.02
#: What is below this part of a goal's scale is rounding.
ROUNDING = 1e-6
#: Part of a goal's scale that may be unsettled: this part of the largest error of a goal, up to
#: changes that are negligible; and this part of the relative error that is asked for, if it is
#: more.
_OF_LARGEST, _NEGLIGIBLE, _OF_ASKED = 0.01, 1e-4, 0.05
#: Further iterations would change a difference by this multiple of the last change in its vector,
#: times what the last iteration left of the residual (docs/results/error.md), and at least by this
#: part of that change: linear solves leave as much of a small component as of the largest one.
_CONTRACTION, _LEAST_CHANGE = 3.0, 0.03
#: The least Newton iterations, as the first change is the whole difference; and the part of the
#: first residual to which the residual is reduced at least.
_LEAST_NEWTON, _REDUCED = 2, 1e-2
#: There is no estimate if more than this part of the forces is rounding: with 1 % errors of 2 % are
#: a quarter too small (a cube stretched by 1e-11).
_LARGEST_ROUNDING = 0.01


@dataclass(frozen=True)
class Differences:
    """What is to be added to each goal.

    Attributes
    ----------
    values : (goals,) array
        The differences.
    unsettled : (goals,) array
        By how much further iterations would change them, about.
    """

    values: Array
    unsettled: Array

    def __add__(self, other: Differences) -> Differences:
        return Differences(self.values + other.values, self.unsettled + other.unsettled)

    def scaled(self, factor: float | Array) -> Differences:
        """Return the differences times a factor."""
        return Differences(factor * self.values, factor * self.unsettled)


class LiftedGoals:
    """Goals of a run in its lifted problem. Collective.

    Parameters
    ----------
    lift : Lift
        Solves the lifted problem.
    goals : sequence of Goal
        The goals.
    estimate : Estimate
        Has their values in the run, and counts the iterations.

    Attributes
    ----------
    values, scales : (goals,) array
        The values in the run, and what their errors are relative to.
    """

    def __init__(
        self,
        lift: Lift,
        goals: Sequence[Goal],
        estimate: Estimate,
    ) -> None:
        self.lift, self.goals, self.estimate = lift, goals, estimate
        self.values, self.scales = values_of(estimate, goals), scales_of(estimate, goals)
        #: Returns the goals in the present state of the lifted problem, (scalars,).
        self.evaluate = bind_all(goals, lift.lifted)

    def iterate(self) -> Array:
        """Make a Newton iteration, and return the goals.

        Raises
        ------
        NoEstimate
            If the solver does not converge.
        """
        self.lift.solve()
        self.estimate.newton, self.estimate.linear = self.lift.newton, self.lift.linear
        return self.evaluate()

    def differences(self, asked: float) -> Differences:
        """Return the goals in the lifted problem less those of the run.

        Of a relative error that is ``asked`` for a small part may be unsettled.

        Raises
        ------
        NoEstimate
            If no stable equilibrium is found, or the differences do not settle.
        """
        lift = self.lift
        values: Array = np.zeros(len(self.values))
        while True:
            before = values
            values = self.iterate() - self.values
            if not np.isfinite(values).all():
                name = lift.lifted.element.name
                raise NoEstimate(f"a goal is not finite in the state of {name}")
            if lift.at_end:
                found = Differences(values, self._unsettled_at_end(values))
            else:
                further = max(_LEAST_CHANGE, _CONTRACTION * lift.last_reduction)
                changes = largest_components(self.goals, values - before)
                found = Differences(values, further * changes)
            enough = lift.newton >= _LEAST_NEWTON and lift.reduction <= _REDUCED
            if lift.at_end or (self._settled(found, asked) and enough and lift.stable):
                break
        if not lift.stable:
            raise lift.unstable("negative curvature")
        return found

    def _settled(self, found: Differences, asked: float) -> bool:
        """Return whether further iterations would change no difference by much."""
        sizes, has_scale = np.abs(found.values), self.scales > 0
        relative = sizes[has_scale] / self.scales[has_scale]
        of_scale = min(_OF_LARGEST * relative.max(initial=0.0), _NEGLIGIBLE)
        of_scale = max(of_scale, _OF_ASKED * asked, ROUNDING)
        limits = np.maximum(SETTLED * sizes, of_scale * self.scales)
        return bool((found.unsettled <= limits).all())

    def _unsettled_at_end(self, values: Array) -> Array:
        """Return what the residual of the lifted problem leaves of differences.

        If the run's state is a solution in it, they are at most about the part that the residual
        is of the forces.

        Raises
        ------
        NoEstimate
            If forces are so small that this part is rounding.
        """
        lift, problem = self.lift, self.lift.problem
        forces = problem.largest_force(problem.x)
        if not forces or is_at_rest(problem):
            return np.zeros(len(values))
        part = lift.residual / forces
        if part > _LARGEST_ROUNDING and lift.residual <= lift.lifted.rounding_force(lift.lifted.x):
            raise NoEstimate(
                f"{100 * part:.2g} % of the forces are within rounding in "
                f"{lift.lifted.element.name}, as strains are so small"
            )
        if lift.newton == 0:
            finite = np.where(np.isfinite(self.scales), self.scales, 0.0)
            return np.maximum(np.abs(values), part * finite)
        return min(_CONTRACTION * lift.reduction, 1.0) * np.abs(values)


def values_of(estimate: Estimate, goals: Sequence[Goal]) -> Array:
    """Return the values of goals in the run."""
    return np.array([estimate.goals[name].value for name in names_of(goals)])


def scales_of(estimate: Estimate, goals: Sequence[Goal]) -> Array:
    """Return what the errors of goals are relative to."""
    return np.array([estimate.goals[name].scale for name in names_of(goals)])


def largest_components(goals: Sequence[Goal], values: Array) -> Array:
    """Return for each scalar the largest size of a component of its goal, (scalars,)."""
    largest = np.zeros(len(values))
    for components in slices_of(goals):
        largest[components] = np.abs(values[components]).max()
    return largest


#: Exponents between which the decay of a cell is sought. 2 is that of a crack in linear elasticity,
#: with the square root of the distance. At the edge of the clamped face of a nearly incompressible
#: body strains are finite, and cells have exponents of 0.8 to 1.2: with 1.5 the estimates are right
#: there (docs/theory/error.md). At 12 a further degree leaves less than a hundredth.
_EXPONENTS = np.linspace(1.5, 12.0, 211)

#: Cells that are evaluated together: some 10 MB of gradients.
_BATCH = 2000


def saturation(lifted: Problem, u: PETSc.Vec) -> float:
    """Return the factor of estimates by a lifted displacement, at least 1. Collective.

    ``u`` is a ghosted vector: the solution, or a mode of vibration.
    A lifted solution of degree 2 has one part alone, and no ratio: the factor is 1.
    """
    if lifted.element.degree < 3:
        return 1.0
    second, third = _parts(lifted, u)
    ratio = np.divide(third, second, out=np.zeros_like(third), where=second > 0)
    further = np.interp(ratio, *_table())
    sums = lifted.comm.allreduce(np.array([third.sum(), (third * further).sum()]))
    return float(1 + sums[1] / sums[0]) if sums[0] > 0 else 1.0


def _table() -> tuple[Array, Array]:
    """Return ratios a_3/a_2, increasing, and the sums of a_k, k > 3, over a_3."""
    powers = {p: np.exp(-log(p) * _EXPONENTS) for p in (2, 3)}
    ratio = (powers[2] - powers[3]) / (1 - powers[2])
    further = powers[3] / (powers[2] - powers[3])
    return ratio[::-1], further[::-1]


def _parts(lifted: Problem, vector: PETSc.Vec) -> tuple[Array, Array]:
    """Return a_2 and a_3 of each cell of this rank."""

    def parts(u: Array, X: Array) -> Array:
        volumes, gradients = _gradients(lifted, u, X, [1, 2, 3])
        steps = [new - old for old, new in pairwise(gradients)]
        return np.stack([(volumes * (d**2).sum(axis=(2, 3))).sum(axis=1) for d in steps], axis=1)

    second, third = _in_batches(lifted, vector, parts).reshape(-1, 2).T
    return second, third


def _in_batches(
    problem: Problem, vector: PETSc.Vec, evaluate: Callable[[Array, Array], Array]
) -> Array:
    """Return a function of the displacements and coordinates of the nodes of owned cells."""
    u = local_values(vector).reshape(-1, problem.kinematics.components)
    nodes = _dolfinx.node_dofs(problem.V)
    geometry = _dolfinx.geometry_dofs(problem.domain)
    X = _dolfinx.geometry_x(problem.domain)[:, : problem.kinematics.dim]
    batches: list[Array] = []
    for first in range(0, len(nodes), _BATCH):
        batch = slice(first, first + _BATCH)
        batches.append(evaluate(u[nodes[batch]], X[geometry[batch]]))
    return np.concatenate(batches) if batches else np.empty(0)


def _gradients(
    problem: Problem, u: Array, X: Array, degrees: Sequence[int]
) -> tuple[Array, list[Array]]:
    """Return the volumes of quadrature points, and gradients of interpolations by degree.

    From displacements and coordinates of the cells' nodes: (cells, points), and for each degree
    (cells, points, components, dim).
    """
    cell, degree = problem.element.cell, problem.element.degree
    points, weights = _dolfinx.quadrature(cell, problem.element.quadrature)
    tangents = _dolfinx.tabulate_geometry(problem.domain, points)
    jacobians = np.einsum("cgi,pgj->cpij", X, tangents, optimize=True)
    volumes = weights * np.abs(np.linalg.det(jacobians))
    if problem.kinematics.revolved:
        volumes *= X[..., 0] @ _dolfinx.tabulate_geometry_values(problem.domain, points).T
    inverse = np.linalg.inv(jacobians)
    gradients = []
    for k in degrees:
        nodes = _dolfinx.reference_nodes(cell, k)
        values = _dolfinx.tabulate_element(cell, degree, nodes, 0)[0] @ u
        basis = _dolfinx.tabulate_element(cell, k, points, 1)[1:]
        reference = np.einsum("jpk,cki->cpij", basis, values, optimize=True)
        gradients.append(reference @ inverse)
    return volumes, gradients
