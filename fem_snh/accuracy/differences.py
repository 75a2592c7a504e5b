"""The differences of goals between a run and its lifted problem, which Newton iterations find."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.goal_errors import Estimate
from fem_snh.accuracy.goals import Goal, names_of
from fem_snh.accuracy.lift import Lift
from fem_snh.accuracy.no_estimate import NoEstimate
from fem_snh.accuracy.rest import is_at_rest

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
    bind : callable, optional
        Returns the function that evaluates a goal in the lifted problem; default: `Goal.bind`.

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
        bind: Callable[[Goal], Callable[[], Sequence[float]]] | None = None,
    ) -> None:
        self.lift, self.goals, self.estimate = lift, goals, estimate
        self.values, self.scales = values_of(estimate, goals), scales_of(estimate, goals)
        bind = bind or (lambda goal: goal.bind(lift.lifted))
        self._functions = [bind(goal) for goal in goals]

    def evaluate(self) -> Array:
        """Return the goals in the present state of the lifted problem."""
        return np.array([value for function in self._functions for value in function()])

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
        lift, name = self.lift, self.lift.lifted.element.name
        values: Array = np.zeros(len(self.values))
        while True:
            before = values
            values = self.iterate() - self.values
            if not np.isfinite(values).all():
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
            raise NoEstimate(
                f"the equilibrium of {name} near the run's is unstable: its Hessian has negative "
                "curvature"
            )
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
    """Return for each scalar the size of the largest one of the same goal, (scalars,)."""
    largest, first = np.zeros(len(values)), 0
    for goal in goals:
        components = slice(first, first + len(goal.names))
        largest[components] = np.abs(values[components]).max()
        first = components.stop
    return largest
