r"""Estimate the errors of goals from the same scene on coarser meshes (Richardson extrapolation).

Where a lifted problem needs more memory than there is, or more time than its user has: half and a
quarter of the cells along an edge have an eighth and a sixty-fourth of the unknowns in three
dimensions. The geometry's error, as of a polyhedron in place of a round body, is included.

With the changes :math:`d_1` from half of the cells to all, and :math:`d_2` from a quarter to half,
the order p is that of :math:`d_2/d_1 = 2^p`, and :math:`d_1/(2^p - 1)` the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.cross_points import check_cross_points
from fem_snh.accuracy.differences import scales_of, values_of
from fem_snh.accuracy.goal_errors import (
    Estimate,
    GoalError,
    NoEstimate,
    NoEstimateOnAnyMesh,
    depends_on_path,
)
from fem_snh.accuracy.goals import Goal, names_of
from fem_snh.accuracy.path_errors import Followed
from fem_snh.accuracy.state_notes import may_lock
from fem_snh.choices import LIFTED_ELEMENT
from fem_snh.errors import bad_value
from fem_snh.problem.problem import Problem

Array = npt.NDArray[np.float64]

#: Least order of the errors, that of nearly incompressible bodies at the end of a clamped face
#: (docs/theory/error.md), and the largest over the degree of the displacement.
_LEAST_ORDER, _MOST_OF_DEGREE = 0.8, 2.0
#: The bound of an error over the larger change where the order is below the least one, or where
#: the changes have different signs.
_IRREGULAR = 2.0
#: The most that the bound of an estimate is over it: 6 with order 2, 9 with order 3.
_MOST_OVER_ERROR = 8.0
#: Changes below this part of a goal's scale need not decrease: the solver leaves that much.
_ROUNDING = 1e-5
#: Number of orders that are compared with the measured one.
_ORDERS = 101

#: What is said of the errors of penalties, which default ones have in inverse proportion to h.
_OF_PENALTIES = (
    "the errors include that of penalties that are stiffer on finer cells, as by default; not that "
    "of a given stiffness, or of the fluid in a cavity"
)


def check_coarsening(problem: Problem) -> None:
    """Raise NoEstimate for a problem whose errors coarser meshes do not show. Collective."""
    check_cross_points(problem)
    if depends_on_path(problem):
        raise NoEstimateOnAnyMesh(
            "the state depends on its path, whose steps coarser meshes do not judge: expected "
            f"accuracy.estimate = '{LIFTED_ELEMENT}'"
        )
    if problem.element.degree == 1 and may_lock(problem):
        raise NoEstimate(
            f"{problem.element.name} locks, on coarser meshes more so: expected another "
            f"element, or accuracy.estimate = '{LIFTED_ELEMENT}'"
        )


def add_extrapolated(
    estimate: Estimate,
    problem: Problem,
    goals: Sequence[Goal],
    runs: Sequence[Followed],
    fineness: tuple[float, float, float],
) -> None:
    """Add the errors of goals, from their values on two coarser meshes, to an estimate. Collective.

    Parameters
    ----------
    estimate : Estimate
        The goals on the run's mesh.
    problem : Problem
        The problem at its solution.
    goals : sequence of Goal
        The goals.
    runs : pair of Followed
        The goals of the same scene on the coarser meshes, the finer one first.
    fineness : triple of float
        Numbers to which the sizes of the cells are inverse: of the run's mesh and of the others.
    """
    estimate.newton = sum(run.newton for run in runs)
    estimate.linear = sum(run.linear for run in runs)
    change = values_of(estimate, goals) - runs[0].values
    before = runs[0].values - runs[1].values
    rounding = _ROUNDING * scales_of(estimate, goals)
    errors, bounds = extrapolated(change, before, fineness, problem.element.degree, rounding)
    for i, name in enumerate(names_of(goals)):
        estimate.goals[name] = with_error(estimate.goals[name], errors[i], bounds[i], change[i])
    if problem.scale_penalties(1.0):
        estimate.left_out.append(_OF_PENALTIES)


def error_from_meshes(values: Sequence[float], cells: Sequence[float], degree: int) -> GoalError:
    """Return the error of a number that was computed on three meshes of one body.

    Parameters
    ----------
    values : sequence of float
        The number on the meshes, the finest last.
    cells : sequence of float
        Their cells along an edge, or other numbers to which the sizes of the cells are inverse.
    degree : int
        The degree of the displacement.

    Returns
    -------
    GoalError
        Of the last value: ``error``, ``corrected``, ``at_most`` (a bound), ``text(name)``.

    Raises
    ------
    BadInput
        For other than three values and increasing numbers of cells.

    Notes
    -----
    See :func:`extrapolated`. An element that locks has changes of any size.
    """
    q, n = np.array(values, dtype=float), np.array(cells, dtype=float)
    if q.shape != (3,) or not np.isfinite(q).all():
        raise bad_value("values", list(values), "three numbers, that of the finest mesh last")
    if n.shape != (3,) or not (np.diff(n) > 0).all() or not n[0] > 0:
        raise bad_value("cells", list(cells), "three positive numbers that increase")
    changes = np.diff(q)
    fineness = float(n[2]), float(n[1]), float(n[0])
    rounding = _ROUNDING * abs(q[2])
    error, bound = extrapolated(changes[1:], changes[:1], fineness, degree, rounding)
    goal = GoalError(float(q[2]), scale=float(abs(q[2])))
    return with_error(goal, error[0], bound[0], changes[1])


def with_error(goal: GoalError, error: float, bound: float, change: float) -> GoalError:
    """Return a goal with its error, at most ``bound``; infinite: without one."""
    if bound == inf:
        reason = f"its changes do not decrease: the last finer mesh changed it by {change:+.2g}"
        return replace(goal, reason=reason)
    # Coarse meshes may have a high order by chance: then the error is printed as a bound, too.
    unsettled = float(bound) if bound > _MOST_OVER_ERROR * abs(error) else 0.0
    return replace(goal, error=float(error), at_most=float(bound), unsettled=unsettled)


def extrapolated(
    change: Array,
    before: Array,
    fineness: tuple[float, float, float],
    degree: int,
    rounding: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Return the errors of goals, and bounds of them.

    A coarse mesh has any order, and a change may be small by chance: the bound is the error with
    the least order, and at least what the change before leaves with that of the degree. Where the
    order is below the least one, or the changes have different signs, the error is zero and the
    bound is twice the larger change. Where they do not decrease the bound is infinite.

    Parameters
    ----------
    change, before : (goals,) array
        What the last and the first refinement change.
    fineness : triple of float
        Of the meshes, the finest first: see `add_extrapolated`.
    degree : int
        That of the displacement.
    rounding : (goals,) array, optional
        Changes up to this need not decrease.
    """
    orders = np.linspace(_LEAST_ORDER, _MOST_OF_DEGREE * degree, _ORDERS)
    sizes = np.array([float(number) ** -orders for number in fineness])  # errors of each order
    changes = np.diff(sizes, axis=0)
    ratios, left = changes[1] / changes[0], sizes[0] / changes[0]
    last, first = np.abs(change), np.abs(before)
    ratio = np.divide(first, last, out=np.full(last.shape, inf), where=last > 0)
    error = change * np.interp(ratio, ratios, left)
    of_degree = np.interp(degree, orders, left / ratios)
    bound = np.maximum(last * left[0], first * of_degree)
    irregular = (last > rounding) & ((ratio < ratios[0]) | (change * before < 0))
    bound = np.where(irregular, _IRREGULAR * np.maximum(last, first), bound)
    bound = np.where(irregular & (first <= last), inf, bound)
    return np.where(irregular, 0.0, error), bound
