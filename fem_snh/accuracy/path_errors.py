"""Estimate the errors of goals whose end depends on the path: the path is followed again.

In time, or with load steps of friction. Once with half the steps (of one step, with two): the
difference, divided by 2^p - 1 of order p, is the error of the steps (Richardson). In time a run
with a quarter of the steps bounds it, and one with an eighth where the changes are small and do not
decrease. Once more with these steps in the lifted element: the difference to the same run of the
own element is the error of the mesh. Where there are penalties, once more with stiffer ones: their
error is inverse to the stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from math import ceil, inf
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.budget import STIFFER, penalty_part, without_penalties
from fem_snh.accuracy.estimate import estimate_with
from fem_snh.accuracy.frequency_goals import FrequencyGoal
from fem_snh.accuracy.goal_errors import LOAD_STEPS, TIME_STEPS, Estimate, bounded_steps
from fem_snh.accuracy.goals import Goal, names_of
from fem_snh.accuracy.lift import (
    ElementDoesNotFit,
    NoEstimate,
    check_body,
    check_memory,
    lifted_dofs,
    lifted_elements,
    memory,
)
from fem_snh.assembly.elements import Element
from fem_snh.mesh.mesh import Mesh
from fem_snh.problem.problem import Problem
from fem_snh.terms.term import LengthTerm

#: The order of time steps with contact, whose beginning and end fall between steps, and that of
#: load steps, whose friction acts along the chord of a step.
_CONTACT_ORDER = 1
#: Fewest time steps of which half are worth comparing.
_FEWEST_STEPS = 4
#: Fewest time steps of which the order is measured, and those that resolve a motion well enough
#: that the errors of mesh and penalties are measured with them: with 50 and 100 steps of a bounce
#: that of the mesh differs by a tenth.
_FEWEST_QUARTER, _ENOUGH_STEPS = 4, 100
#: Half and a quarter of the time steps are compared.
_HALVES = 4
#: Two estimates of a penalty's error agree if one is less than so many times the other.
_AGREE = 2.0
#: The bound of an error over the larger change where changes do not decrease.
_IRREGULAR = 2.0
#: Changes up to this part of a goal's scale bound the error where they do not decrease, if a third
#: one, by the first refinement of three, is not more than four times as large.
_SMALL_CHANGES = 0.05
#: Two refinements of order 1 divide a change by this.
_LEFT_BY_TWO = 4.0
#: Changes below this part of a goal's scale are not those of steps: the solvers leave that much.
_ROUNDING = 1e-5
#: The least ratio of the numbers of steps that are compared.
_LEAST_RATIO = 1.5


class Path(Protocol):
    """The path to the state of a problem, which can be followed again from its beginning.

    Attributes
    ----------
    steps, taken : int
        The given number of equal steps, and that of the steps taken: some failed and were halved.
    """

    @property
    def steps(self) -> int: ...
    @property
    def taken(self) -> int: ...

    def follow(
        self, steps: int, goals: Sequence[Goal], element: Element | None, stiffer: float
    ) -> Followed:
        """Follow the path in other steps, with another element, stiffer penalties. Collective.

        Raises
        ------
        NoEstimate
            If the element does not fit, or the path does not reach its end.
        """


class Followed(NamedTuple):
    """The goals at the end of a path, the number of its steps, and what they cost."""

    values: npt.NDArray[Any]
    taken: int
    newton: int
    linear: int
    jit: float


def end_of(
    stepper: Iterable[dict[str, Any]], problem: Problem, goals: Sequence[Goal], what: str
) -> Followed:
    """Return the goals at the end of the steps of a `fem_snh.steps.stepping.Stepper`. Collective.

    Raises
    ------
    NoEstimate
        If they do not reach it, or a goal is not finite there.
    """
    newton = linear = 0
    for row in stepper:
        newton += row["newton"]
        linear += row["linear"]
    steps: Any = stepper
    if not steps.done:
        raise NoEstimate(f"{what}: {steps.failure_message()}")
    values = np.array([v for goal in goals for v in goal.bind(problem)()])
    if not np.isfinite(values).all():
        raise NoEstimate(f"a goal is not finite {what}")
    return Followed(values, steps.taken, newton, linear, problem.seconds["jit"])


def estimate_on_path(
    problem: Problem,
    path: Path,
    goals: Sequence[Goal],
    announce: Callable[[Estimate], None] = lambda estimate: None,
    mesh: Mesh | None = None,
) -> Estimate:
    """Return the errors of goals at the end of a motion, or of load steps. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at the end of the path; its state is unchanged.
    path : Path
        How it came there.
    goals : sequence of Goal
        The goals.
    announce : callable, optional
        Called with the cost, before the path is followed.
    mesh : Mesh, optional
        The mesh of a scene.
    """

    def find(found: Estimate) -> None:
        known = [goal for goal in goals if not isinstance(goal, FrequencyGoal)]
        found.on_no_mesh = len(known) < len(goals)
        parts = _errors(problem, path, known, found, announce)
        for i, name in enumerate(names_of(known)):
            own = {part: float(errors[i]) for part, errors in parts.items()}
            goal = found.goals[name]
            if goal.reason:
                own.pop(_source(problem))
                found.goals[name] = replace(goal, parts=own)
                continue
            # Irregular steps have no estimate: the error is printed as a bound.
            unsettled = goal.steps_bound if bounded_steps(own, goal.steps_bound) else 0.0
            error = sum(own.values())
            found.goals[name] = replace(goal, error=error, parts=own, unsettled=unsettled)

    return estimate_with(find, problem, goals, mesh)


def _errors(
    problem: Problem,
    path: Path,
    goals: Sequence[Goal],
    found: Estimate,
    announce: Callable[[Estimate], None],
) -> dict[str, npt.NDArray[Any]]:
    """Return the errors of steps, mesh and penalties; raise NoEstimate if there are none."""
    steps, motion = path.steps, problem.motion
    check_body(problem)
    if motion and steps < _FEWEST_STEPS:
        raise NoEstimate(f"{steps} time steps: expected at least {_FEWEST_STEPS}")
    element, *others = _lifted_elements(problem)
    found.element, found.dofs = element.name, lifted_dofs(problem, element)
    found.memory, found.again = memory(problem, element), ceil(steps / 2) if steps > 1 else 2
    announce(found)
    check_memory(problem, found.memory)

    def follow(steps: int, element: Element | None = None, stiffer: float = 1.0) -> Followed:
        again = path.follow(steps, goals, element, stiffer)
        found.newton += again.newton
        found.linear += again.linear
        found.jit += again.jit
        return again

    known = [found.goals[name] for name in names_of(goals)]
    values = np.array([goal.value for goal in known])
    coarse = half = follow(found.again)
    finer = path.taken / half.taken  # with more steps than in the run, of one step, below 1
    if 1 / _LEAST_RATIO < finer < _LEAST_RATIO:
        raise NoEstimate(
            f"with half the steps some failed and were halved: {half.taken} steps beside the run's "
            f"{path.taken} are no comparison"
        )
    before, few = np.zeros(len(values)), ceil(found.again / 2)
    on = found.again  # the steps of the paths that show the errors of the mesh and the penalties
    if motion and few >= _FEWEST_QUARTER and 2 * few == found.again:
        quarter = follow(few)
        if 2 * quarter.taken == half.taken:
            before = half.values - quarter.values
            if few >= _ENOUGH_STEPS:
                on, coarse = few, quarter
    if motion and not before.any():
        found.left_out.append(
            f"the order of {path.taken} time steps was not measured: their error may be larger "
            f"than its estimate, which takes order {motion.integrator.order}; a multiple of "
            f"{_HALVES} steps, {_HALVES * _FEWEST_QUARTER} or more, shows it"
        )
    for term in problem.terms:
        if isinstance(term, LengthTerm):
            found.left_out.append(f"the errors do not include that of the gap: {term.length_text}")
    orders = [_CONTACT_ORDER, motion.integrator.order if motion else _CONTACT_ORDER]
    if not problem.history.by_name:  # without contact
        orders[0] = orders[1]
    rounding = np.array([_ROUNDING * goal.scale for goal in known])
    change = values - half.values
    steps_error, found_bounds = steps_errors(change, before, finer, orders, rounding)
    limits = np.array([_SMALL_CHANGES * goal.scale for goal in known])
    unordered = (found_bounds == inf) & (np.maximum(abs(change), abs(before)) <= limits)
    if unordered.any() and (fewer := ceil(few / 2)) >= _FEWEST_QUARTER:
        eighth = follow(fewer)
        if eighth.taken == fewer:
            changes = np.array([change, before, quarter.values - eighth.values])
            bounds = bounds_of_small_changes(changes, limits, orders[1])
            found_bounds = np.where(unordered, bounds, found_bounds)
    for i, (name, bound) in enumerate(zip(names_of(goals), found_bounds, strict=True)):
        reason = _no_order(before[i], change[i]) if bound == inf else ""
        found.goals[name] = replace(found.goals[name], steps_bound=float(bound), reason=reason)
    if all(found.goals[name].reason for name in names_of(goals)):
        return {_source(problem): steps_error}
    penalties = problem.scale_penalties(1.0)

    @cache
    def stiffened(factor: float) -> npt.NDArray[Any]:
        return follow(on, stiffer=factor).values if factor != 1 else coarse.values

    penalty, stiffer = None, 1.0
    if penalties and not motion:
        scales = np.array([found.goals[name].scale for name in names_of(goals)])
        try:
            penalty = without_penalties(coarse.values, scales, stiffened, verify=False)
            stiffer = STIFFER  # the mesh has another error without penalties: most of it with these
        except NoEstimate as error:
            found.left_out.append(f"the error of penalties is not known: {error}")
    lifted = None
    while lifted is None:
        try:
            lifted = follow(on, element, stiffer)
        except ElementDoesNotFit:
            if not others:
                raise
            element, *others = others
            found.element = element.name
    if penalties and motion:
        by_stiffer = penalty_part(coarse.values, stiffened(STIFFER))
        by_softer = penalty_part(stiffened(1 / STIFFER), coarse.values) / STIFFER
        penalty = resolved_penalty(by_stiffer, by_softer)
    parts = {_source(problem): steps_error, "mesh": lifted.values - stiffened(stiffer)}
    if penalty is not None:
        parts["penalty"] = penalty
    return parts


def bounds_of_small_changes(
    changes: npt.NDArray[Any], limits: npt.NDArray[Any], order: int
) -> npt.NDArray[Any]:
    """Return bounds of the errors of steps where changes (3, goals) do not decrease.

    The last change is the first row. Of three refinements the first one finds what the others may
    miss by chance; with order 1 a quarter of its change would remain. Twice the largest bounds the
    error if it is within the limits (goals,), elsewhere the bound is infinite. An integrator of
    order 1 leaves as much as the last change again: its bound is twice as large.
    """
    sizes = np.abs(changes)
    sizes[2] /= _LEFT_BY_TWO
    largest = sizes.max(axis=0)
    return np.where(largest <= limits, _IRREGULAR * (2 if order == 1 else 1) * largest, inf)


def _no_order(before: float, change: float) -> str:
    """Return why a goal has no estimate, with its changes by twice as many steps."""
    return (
        f"its changes do not decrease: twice as many time steps changed it by {before:+.2g}, and "
        f"twice as many again by {change:+.2g}"
    )


def _source(problem: Problem) -> str:
    """Return the name of the part of the errors that steps have."""
    return TIME_STEPS if problem.motion else LOAD_STEPS


def _lifted_elements(problem: Problem) -> list[Element]:
    """Return the elements of the lifted runs, of which the first one that fits is taken.

    Where the elements do not lock, one of degree 3 without a pressure: its matrix is definite, and
    each of many steps costs a fraction.
    """
    elements = list(lifted_elements(problem))
    definite = elements[-1].volume == problem.element.volume == "pointwise"
    return elements[-1:] if definite and problem.element.degree > 1 else elements


def resolved_penalty(by_stiffer: npt.NDArray[Any], by_softer: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the errors of penalties in time, from stiffer and from softer ones.

    Both are about the same where the time steps resolve the vibration of the stiffer ones.
    Elsewhere the softer ones have the right one.
    """
    agree = np.sign(by_stiffer) == np.sign(by_softer)
    agree &= np.abs(by_stiffer) < _AGREE * np.abs(by_softer)
    agree &= np.abs(by_softer) < _AGREE * np.abs(by_stiffer)
    return np.where(agree, by_stiffer, by_softer)


def steps_errors(
    change: npt.NDArray[Any],
    before: npt.NDArray[Any],
    finer: float,
    orders: Sequence[int],
    rounding: npt.NDArray[Any] | float = 0.0,
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the errors of the steps of goals, and bounds of them.

    The order is measured by both changes where there is one ``before``. Steps that hardly resolve
    the motion have any order, and a change may be small by chance: the bound is the error with
    order 1, and at least what the change before leaves at the largest order. Changes that
    decrease slower than with order 1 say nothing of the sign: the error is zero, and the bound is
    twice the larger change. Where they do not decrease, both may be small by chance, and further
    ones of any size: the bound is infinite; see `bounds_of_small_changes`.

    Parameters
    ----------
    change, before : (goals,) array
        What the last and the first refinement of the steps change; zero: unknown.
    finer : float
        The ratio of the numbers of steps.
    orders : pair of int
        The least and the largest order.
    rounding : (goals,) array, optional
        Changes up to this are those of the solver's tolerance: they need not decrease.
    """
    last, first = np.abs(change), np.abs(before)
    least, most = (finer**order for order in orders)
    ratio = np.divide(first, last, out=np.full(last.shape, least), where=last > 0)
    error = change / (np.clip(ratio, min(least, most), max(least, most)) - 1)
    bound = np.maximum(last / abs(finer - 1), first / most)
    irregular = (first > 0) & (first < finer**_CONTACT_ORDER * last)
    bound = np.where(irregular, _IRREGULAR * np.maximum(last, first), bound)
    bound = np.where(irregular & (first <= last) & (last > rounding), inf, bound)
    return np.where(irregular, 0.0, error), bound
