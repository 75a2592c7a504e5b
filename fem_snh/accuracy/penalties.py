"""The part of an error that penalties have: it is inverse to their stiffness where it is small.

It shows in the run's own element: the state is followed to stiffer penalties, then restored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from fem_snh import solver
from fem_snh.accuracy.differences import SETTLED
from fem_snh.accuracy.effectivity import of_order
from fem_snh.accuracy.goal_errors import Estimate, NoEstimate
from fem_snh.arrays import Array
from fem_snh.problem.goals import Goal, bind_all, slices_of
from fem_snh.problem.problem import Problem

#: Prefix of its solver's options: those of the run are for its load steps.
PREFIX = f"{solver.PREFIX}penalty_"
#: Factor of the stiffness. The error is c/k: from k to 4 k it loses three quarters, which is more
#: than what Newton's method leaves, and the state is near enough for a few iterations.
STIFFER = 4.0
#: Stiffer penalties are tried so many times at most.
_MOST_TIMES = 8


def penalty_errors(
    problem: Problem, goals: Sequence[Goal], estimate: Estimate, update: Any = None
) -> tuple[Array, Array] | None:
    """Return what goals would change by without penalties, and what that may miss. Collective.

    None if there are no penalties, nor a barrier. The problem and its state are unchanged.

    Parameters
    ----------
    problem : Problem
        The problem with penalties, at its solution.
    goals : sequence of Goal
        The goals.
    estimate : Estimate
        Has their values and what their errors are relative to, and counts the iterations.
    update : tuple, optional
        Arguments of ``snes.setUpdate``.

    Raises
    ------
    NoEstimate
        If no equilibrium with a larger stiffness is found.
    """
    present, values = STIFFER, estimate.values(goals)
    evaluate, start = bind_all(goals, problem), problem.x.copy()
    if not problem.scale_penalties(present):
        return None
    snes, outcome = solver.create(problem, prefix=PREFIX), solver.StepOutcome()

    def stiffened(factor: float) -> Array:
        nonlocal present
        problem.scale_penalties(factor / present)
        present = factor
        solver.solve_until_settled(problem, snes, outcome)
        if not outcome.converged:
            raise NoEstimate(
                f"no equilibrium of {problem.element.name} was found with {factor:g} times the "
                f"stiffness of the penalties ({outcome.reason} after {outcome.newton} Newton "
                "iterations)"
            )
        problem.split(problem.x)
        return evaluate()

    try:
        if update:
            snes.setUpdate(*update)
        # What the run's tolerance left is no part of what penalties change.
        snes.getPythonContext().force_iteration = True
        with suppress(NoEstimate):
            values = stiffened(1.0)
        return without_penalties(goals, values, estimate.scales(goals), stiffened)
    finally:
        problem.scale_penalties(1 / present)
        estimate.newton += outcome.newton
        solver.destroy(snes)
        start.copy(problem.x)
        problem.split(problem.x)


def without_penalties(
    goals: Sequence[Goal], values: Array, scales: Array, stiffened: Callable[[float], Array]
) -> tuple[Array, Array]:
    """Return what goals would change by without penalties, and what that may miss.

    Stiffer ones are tried until it is a small part of the goals' scales.

    Parameters
    ----------
    goals : sequence of Goal
        The goals.
    values, scales : (goals,) array
        Their values, and what their errors are relative to.
    stiffened : callable
        Returns the goals with penalties so many times stiffer than the run's. It raises NoEstimate
        if there is no equilibrium.
    """
    levels = [values, stiffened(STIFFER)]
    left, missed = np.zeros((2, len(values)))
    while True:
        powers = [STIFFER] * (len(levels) - 1)
        for part in slices_of(goals):
            left[part], missed[part] = of_order([level[part] for level in levels], powers)
        enough = len(levels) > 2 and (missed <= SETTLED * scales).all()
        if enough or len(levels) > _MOST_TIMES:
            break
        try:
            levels.append(stiffened(STIFFER ** len(levels)))
        except NoEstimate:
            break
    return levels[-1] + left - values, missed
