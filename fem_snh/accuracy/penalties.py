"""The part of an error that penalties have: it is inverse to their stiffness where it is small.

It shows in the run's own element: the state is followed to stiffer penalties, then restored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import solver
from fem_snh.accuracy.effectivity import of_order
from fem_snh.accuracy.goal_errors import NoEstimate
from fem_snh.problem.goals import Goal, bind_all, slices_of
from fem_snh.problem.problem import Problem

Array = npt.NDArray[np.float64]

#: Prefix of its solver's options: those of the run are for its load steps.
PREFIX = f"{solver.PREFIX}penalty_"
#: Factor of the stiffness. The error is c/k: from k to 4 k it loses three quarters, which is more
#: than what Newton's method leaves, and the state is near enough for a few iterations.
STIFFER = 4.0
#: Stiffer penalties are tried until a part of the goals' scales is left, or so many times.
_LITTLE_LEFT, _MOST_TIMES = 0.02, 8


def penalty_errors(
    problem: Problem,
    goals: Sequence[Goal],
    scales: Array,
    outcome: solver.StepOutcome,
) -> tuple[Array, Array] | None:
    """Return what goals would change by without penalties, and what that may miss. Collective.

    None if there are no penalties. The problem and its state are unchanged.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    goals : sequence of Goal
        The goals.
    scales : (goals,) array
        What their errors are relative to.
    outcome : StepOutcome
        Counts the iterations.

    Raises
    ------
    NoEstimate
        If no equilibrium with a larger stiffness is found.
    """
    if not problem.scale_penalties(STIFFER):
        return None
    problem.scale_penalties(1 / STIFFER)
    present, evaluate = 1.0, bind_all(goals, problem)

    def stiffened(factor: float) -> Array:
        nonlocal present
        problem.scale_penalties(factor / present)
        present = factor
        found = _goals_after(problem, snes, evaluate, outcome)
        if found is None:
            raise NoEstimate(
                f"no equilibrium of {problem.element.name} was found with {factor:g} times the "
                f"stiffness of the penalties ({outcome.reason} after {outcome.newton} Newton "
                "iterations)"
            )
        return found

    with _solver(problem) as snes:
        try:
            values = evaluate()
            # What the run's tolerance left is no part of what penalties change.
            snes.getPythonContext().force_iteration = True
            further = _goals_after(problem, snes, evaluate, outcome)
            return without_penalties(
                goals, values if further is None else further, scales, stiffened
            )
        finally:
            problem.scale_penalties(1 / present)


def without_penalties(
    goals: Sequence[Goal], values: Array, scales: Array, stiffened: Callable[[float], Array]
) -> tuple[Array, Array]:
    """Return what goals would change by without penalties, and what that may miss.

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
    levels, factor, finite = [values, stiffened(STIFFER)], STIFFER, np.isfinite(scales)
    while True:
        left, missed = penalty_part(goals, levels)
        enough = (missed[finite] <= _LITTLE_LEFT * scales[finite]).all()
        if len(levels) > _MOST_TIMES or (enough and len(levels) > 2):
            break
        factor *= STIFFER
        try:
            levels.append(stiffened(factor))
        except NoEstimate:
            break
    return levels[-1] + left - values, missed


def penalty_part(goals: Sequence[Goal], levels: Sequence[Array]) -> tuple[Array, Array]:
    """Return what is to be added to the last of levels, and what it may miss, (scalars,) each.

    Each is `STIFFER` times as stiff as the one before.
    """
    powers, (left, missed) = [STIFFER] * (len(levels) - 1), np.zeros((2, len(levels[0])))
    for part in slices_of(goals):
        left[part], missed[part] = of_order([values[part] for values in levels], powers)
    return left, missed


def _goals_after(
    problem: Problem,
    snes: PETSc.SNES,
    evaluate: Callable[[], Array],
    outcome: solver.StepOutcome,
) -> Array | None:
    """Return the goals after a further solve; None if it fails. Collective."""
    solver.solve_until_settled(problem, snes, outcome)
    if not outcome.converged:
        return None
    problem.split(problem.x)
    return evaluate()


@contextmanager
def _solver(problem: Problem) -> Iterator[PETSc.SNES]:
    """Yield another solver of a problem, whose state is restored at the end. Collective."""
    snes = solver.create(problem, prefix=PREFIX)
    start = problem.x.copy()
    try:
        yield snes
    finally:
        solver.destroy(snes)
        start.copy(problem.x)
        problem.split(problem.x)
