"""Parts of an error that the run's own element shows: penalties, and what Newton's method left.

The state is followed to stiffer penalties, or by one more Newton iteration; then it is restored.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import solver
from fem_snh.accuracy.goals import Goal
from fem_snh.accuracy.lift import NoEstimate
from fem_snh.problem.problem import Problem

#: Prefixes of the solvers' options: those of the run are for its load steps.
PREFIX, _ALGEBRA_PREFIX = f"{solver.PREFIX}penalty_", f"{solver.PREFIX}algebra_"
#: Factor of the stiffness. The error is c/k: from k to 4 k it loses three quarters, which is more
#: than what Newton's method leaves, and the state is near enough for a few iterations.
STIFFER = 4.0
#: An iteration that does not reduce the residual to this part is followed by another one, of which
#: there are so many at most.
_REDUCED, _MOST_NEWTON = 0.999, 3


def penalty_errors(
    problem: Problem, goals: Sequence[Goal], values: npt.ArrayLike, outcome: solver.StepOutcome
) -> npt.NDArray[np.float64] | None:
    """Return what goals would change by without penalties; None if there are none. Collective.

    To first order in the inverse stiffness. The problem and its state are unchanged.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    goals : sequence of Goal
        The goals.
    values : sequence of float
        Their values.
    outcome : StepOutcome
        Counts the iterations.

    Raises
    ------
    NoEstimate
        If no equilibrium with the larger stiffness is found.
    """
    if not problem.scale_penalties(STIFFER):
        return None
    snes = solver.create(problem, prefix=PREFIX)
    try:
        stiff = _goals_after(problem, snes, goals, outcome)
    finally:
        problem.scale_penalties(1 / STIFFER)
    if stiff is None:
        raise NoEstimate(
            f"no equilibrium was found with {STIFFER:g} times the stiffness of the "
            f"penalties ({outcome.reason} after {outcome.newton} Newton iterations)"
        )
    return penalty_part(np.asarray(values), stiff)


def penalty_part(values: npt.NDArray[Any], stiff: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return what goals would change by without penalties, from those with `STIFFER` ones."""
    return (stiff - values) * STIFFER / (STIFFER - 1)


def algebra_errors(
    problem: Problem, goals: Sequence[Goal], values: npt.ArrayLike
) -> npt.NDArray[np.float64] | None:
    """Return what another Newton iteration changes of goals. Collective.

    It is None where no iteration reduces the residual. The problem and its state are unchanged.
    Parameters are those of `penalty_errors`.
    """
    snes = solver.create(problem, prefix=_ALGEBRA_PREFIX, examine_stability=False)
    snes.setTolerances(rtol=_REDUCED, atol=0, stol=0, max_it=_MOST_NEWTON)
    further = _goals_after(problem, snes, goals, solver.StepOutcome())
    return None if further is None else further - np.asarray(values)


def _goals_after(
    problem: Problem, snes: PETSc.SNES, goals: Sequence[Goal], outcome: solver.StepOutcome
) -> npt.NDArray[np.float64] | None:
    """Return the goals of a further solve, None if it fails; destroy the solver. Collective."""
    start = problem.x.copy()
    try:
        solver.solve_until_settled(problem, snes, outcome)
        if not outcome.converged:
            return None
        problem.split(problem.x)
        return np.array([value for goal in goals for value in goal.bind(problem)()])
    finally:
        solver.destroy(snes)
        start.copy(problem.x)
        problem.split(problem.x)
