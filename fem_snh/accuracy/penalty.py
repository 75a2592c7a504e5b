"""What a penalty changes: the state is followed to a larger stiffness, in the run's own element."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fem_snh import solver
from fem_snh.accuracy.goals import Goal
from fem_snh.accuracy.lift import NoEstimate
from fem_snh.problem.problem import Problem

#: Prefix of the solver's options: those of the run are for its load steps.
PREFIX = f"{solver.PREFIX}penalty_"
#: Factor of the stiffness. The error is c/k: from k to 4 k it loses three quarters, which is more
#: than what Newton's method leaves, and the state is near enough for a few iterations.
_FACTOR = 4.0


def penalty_errors(
    problem: Problem, goals: Sequence[Goal], values: Sequence[float], outcome: solver.StepOutcome
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
    if not problem.scale_penalties(_FACTOR):
        return None
    start, snes = problem.x.copy(), solver.create(problem, prefix=PREFIX)
    try:
        solver.solve_until_settled(problem, snes, outcome)
        if not outcome.converged:
            raise NoEstimate(
                f"no equilibrium was found with {_FACTOR:g} times the stiffness of the "
                f"penalties ({outcome.reason} after {outcome.newton} Newton iterations)"
            )
        problem.split(problem.x)
        stiff = np.array([value for goal in goals for value in goal.bind(problem)()])
    finally:
        problem.scale_penalties(1 / _FACTOR)
        solver.destroy(snes)
        start.copy(problem.x)
        problem.split(problem.x)
    return (stiff - np.asarray(values)) * _FACTOR / (_FACTOR - 1)
