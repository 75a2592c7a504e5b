"""Parts of an error that the run's own element shows: penalties, and what Newton's method left.

The state is followed to stiffer penalties, or by one more Newton iteration; then it is restored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import solver
from fem_snh.accuracy.differences import largest_components
from fem_snh.accuracy.goal_errors import NoEstimate
from fem_snh.accuracy.goals import Goal, bind_all
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]

#: Prefixes of the solvers' options: those of the run are for its load steps.
PREFIX, _ALGEBRA_PREFIX = f"{solver.PREFIX}penalty_", f"{solver.PREFIX}algebra_"
#: Factor of the stiffness. The error is c/k: from k to 4 k it loses three quarters, which is more
#: than what Newton's method leaves, and the state is near enough for a few iterations.
STIFFER = 4.0
#: A first change that is larger than this part of the goal is followed by that of still stiffer
#: penalties, whose ratio shows how the error decreases: not as c/k where they yield much, or where
#: pairs of surfaces change. They are made stiffer until this part of the goal is left, or so many
#: times.
_SMALL, _LEFT, _MOST_STIFFER = 0.01, 0.02, 8
#: A part of penalties that is more than this, relative to a goal, or than the error that is asked
#: for, is found in the lifted problem: on few facets all of it may be the run's element's own.
_YIELDS = 0.05
#: Part of what penalties change that is unsettled where surfaces of the body touch each other: the
#: pairs change, and stiffer penalties may find another state. Measured with self-contact; a term
#: with ``unsettled_penalty`` has its own.
_OF_PAIRS = 0.35
#: Where surfaces of the body touch each other, components beside the largest one of a vector are
#: unsettled by this multiple of what penalties change of them, or by this part of the most that
#: they change in the vector, if that is less. With 100 times the stiffness the components of the
#: force between two bodies change by another amount than was found, by up to 1.6 times that and
#: 0.29 of the most.
_BESIDE, _OF_MOST = 2.0, 0.35
#: Largest ratio of two changes that is believed.
_SLOWEST = 0.8
#: An iteration that does not reduce the residual to this part is followed by another one, of which
#: there are so many at most.
_REDUCED, _MOST_NEWTON = 0.999, 3
#: Relative tolerance of its linear solves, below Newton's tolerance too.
_LINEAR = 1e-2


def penalty_errors(
    problem: Problem,
    goals: Sequence[Goal],
    values: Array,
    scales: Array,
    outcome: solver.StepOutcome,
) -> Array | None:
    """Return what goals would change by without penalties; None if there are none. Collective.

    The problem and its state are unchanged.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    goals : sequence of Goal
        The goals.
    values, scales : (goals,) array
        Their values, and what their errors are relative to.
    outcome : StepOutcome
        Counts the iterations.

    Raises
    ------
    NoEstimate
        If no equilibrium with a larger stiffness is found, or the goals do not settle.
    """
    if not problem.scale_penalties(STIFFER):
        return None
    present = STIFFER

    def stiffened(factor: float) -> Array:
        nonlocal present
        problem.scale_penalties(factor / present)
        present = factor
        found = _goals_after(problem, snes, goals, outcome)
        if found is None:
            raise NoEstimate(
                f"no equilibrium of {problem.element.name} was found with {factor:g} times the "
                f"stiffness of the penalties ({outcome.reason} after {outcome.newton} Newton "
                "iterations)"
            )
        return found

    snes = solver.create(problem, prefix=PREFIX)
    with _restored(problem, snes):
        try:
            return without_penalties(values, scales, stiffened)
        finally:
            problem.scale_penalties(1 / present)


def without_penalties(
    values: Array, scales: Array, stiffened: Callable[[float], Array], verify: bool = True
) -> Array:
    """Return what goals would change by without penalties.

    To first order in the inverse stiffness, from one at which that is small.

    Parameters
    ----------
    values, scales : (goals,) array
        The goals, and what their errors are relative to.
    stiffened : callable
        Returns the goals with penalties so many times stiffer than the run's.
    verify : bool
        Whether a first change that is not small is followed by another one, even if little is left.

    Raises
    ------
    NoEstimate
        If the goals do not settle.
    """
    last, factor, change = values, 1.0, np.zeros_like(values)
    for repeated in range(_MOST_STIFFER):
        factor *= STIFFER
        before, earlier, last = last, change, stiffened(factor)
        change = last - before
        ratio = np.full_like(values, 1 / STIFFER)
        np.divide(change, earlier, out=ratio, where=earlier != 0)
        ratio = np.clip(ratio, 1 / STIFFER, _SLOWEST)
        left = change * ratio / (1 - ratio)
        sizes = np.maximum(scales, np.abs(last))
        first = verify and not repeated and (np.abs(change) > _SMALL * sizes).any()
        if not first and (np.abs(left) <= _LEFT * sizes).all():
            return np.asarray(last - values + left)
    raise NoEstimate(f"goals still change with penalties that are {factor:,.0f} times stiffer")


def penalty_part(values: Array, stiff: Array) -> Array:
    """Return what goals would change by without penalties, from those with `STIFFER` ones."""
    return (stiff - values) * STIFFER / (STIFFER - 1)


def yield_much(penalties: Array, scales: Array, asked: float) -> bool:
    """Return whether penalties are a part of the error that the better element has to confirm.

    Parameters
    ----------
    penalties, scales : (goals,) array
        The part that is added for penalties, and what errors are relative to.
    asked : float
        The relative error that is asked for; 0: none is.
    """
    most = min(asked or _YIELDS, _YIELDS)
    relative = np.abs(penalties[scales > 0]) / scales[scales > 0]
    return bool(relative.max(initial=0.0) > most)


def unsettled_penalties(
    problem: Problem, goals: Sequence[Goal], values: Array, penalties: Array
) -> Array:
    """Return what is unsettled of the part of penalties; zero if no surfaces of the body touch.

    Parameters
    ----------
    problem : Problem
        The problem.
    goals : sequence of Goal
        The goals.
    values, penalties : (goals,) array
        Their values, and the part that is added for penalties.
    """
    if not problem.coupling_terms:
        return np.zeros(len(values))
    sizes, changes = np.abs(values), np.abs(penalties)
    parts = [term.unsettled_penalty or _OF_PAIRS for term in problem.coupling_terms]
    unsettled = max(parts) * changes
    beside = np.minimum(_BESIDE * changes, _OF_MOST * largest_components(goals, changes))
    is_smaller = sizes < largest_components(goals, sizes)
    return np.where(is_smaller, np.maximum(unsettled, beside), unsettled)


def algebra_errors(problem: Problem, goals: Sequence[Goal], values: Array) -> Array | None:
    """Return what another Newton iteration changes of goals. Collective.

    It is None where no iteration reduces the residual. The problem and its state are unchanged.
    Parameters are those of `penalty_errors`.
    """
    snes = solver.create(problem, prefix=_ALGEBRA_PREFIX, examine_stability=False)
    snes.setTolerances(max_it=_MOST_NEWTON)
    context = snes.getPythonContext()
    context.reduction, context.force_iteration = _REDUCED, True
    context.options |= {"snes_forcing_max": _LINEAR, "snes_forcing_safeguard": 0.0}
    with _restored(problem, snes):
        further = _goals_after(problem, snes, goals, solver.StepOutcome())
    return None if further is None else further - values


def _goals_after(
    problem: Problem, snes: PETSc.SNES, goals: Sequence[Goal], outcome: solver.StepOutcome
) -> Array | None:
    """Return the goals of a further solve; None if it fails. Collective."""
    solver.solve_until_settled(problem, snes, outcome)
    if not outcome.converged:
        return None
    problem.split(problem.x)
    return bind_all(goals, problem)()


@contextmanager
def _restored(problem: Problem, snes: PETSc.SNES) -> Iterator[None]:
    """Restore the state of a problem at the end of the context, and destroy a solver."""
    start = problem.x.copy()
    try:
        yield
    finally:
        solver.destroy(snes)
        start.copy(problem.x)
        problem.split(problem.x)
