"""The errors of goals after each step, from the change that half the cells make there.

Where a goal is evaluated, its error and bound are known as multiples of its change from the coarser
mesh. Along the path they are taken for the same multiples. As the changes of two causes may cancel,
a bound is at least that of a fifth of the largest change (`effectivity.OF_VECTOR`), and as large a
part of the largest bound as the value is of the largest value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fem_snh.accuracy.effectivity import OF_VECTOR
from fem_snh.accuracy.goal_errors import Estimate, GoalCurve, GoalError
from fem_snh.accuracy.path_errors import GoalHistory
from fem_snh.arrays import Array
from fem_snh.problem.goals import Goal, names_of, slices_of


def curves_of(
    estimate: Estimate, goals: Sequence[Goal], run: GoalHistory, coarse: GoalHistory
) -> dict[str, GoalCurve]:
    """Return the curves of goals whose errors have bounds, by name.

    A vector that hardly changes from mesh to mesh where it is evaluated has none.

    Parameters
    ----------
    estimate : Estimate
        The errors of the goals where they are evaluated.
    goals : sequence of Goal
        The goals.
    run, coarse : GoalHistory
        All components after each step, of the run and of a coarser mesh.
    """
    found: dict[str, GoalCurve] = {}
    fine = run.values
    loads, names = sorted(fine), names_of(goals)
    values = np.array([fine[load] for load in loads])
    changes = values - np.array([coarse.at(load) for load in loads])
    for part in slices_of(goals):
        known = [estimate.goals[name] for name in names[part]]
        there = estimate.loads.get(names[part.start], loads[-1])
        if there not in fine or any(goal.bound is None for goal in known):
            continue
        tables = _along(values[:, part], changes[:, part], loads.index(there), known)
        for i, name in enumerate(names[part] if tables else ()):
            columns = (table[:, i].tolist() for table in tables)
            found[name] = GoalCurve(*(dict(zip(loads, c, strict=True)) for c in columns))
    return found


def _along(values: Array, changes: Array, at: int, known: Sequence[GoalError]) -> tuple[Array, ...]:
    """Return a vector, its errors and bounds after each step, (steps, n) each; () if unknown.

    Parameters
    ----------
    values, changes : (steps, n) array
        The vector, and by how much it differs from that of the coarser mesh.
    at : int
        The step in which it is evaluated.
    known : sequence of GoalError
        Its errors there.
    """
    error = np.array([goal.error or 0.0 for goal in known])
    bound = np.array([goal.bound or 0.0 for goal in known])
    sizes, change = np.abs(changes), changes[at]
    largest, size = sizes.max(), sizes[at].max()
    if size < OF_VECTOR * largest or size == 0:
        return () if largest or error.any() else (values, changes, sizes)
    multiple = float(error @ change) / float(change @ change)
    of_change = (bound.max() + np.abs(error - multiple * change).max()) / size
    ways = np.abs(values - values[0])
    of_largest = np.divide(ways, ways.max(axis=0), out=np.zeros_like(ways), where=ways > 0)
    errors, bounds = multiple * changes, of_change * np.maximum(sizes, OF_VECTOR * largest)
    bounds = np.maximum(bounds, bound * of_largest)
    errors[at], bounds[at] = error, bound
    return values, errors, bounds
