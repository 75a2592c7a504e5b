"""Estimate the errors of goals whose end depends on the path: the path is followed again.

In time, or with load steps of friction. Once with half the steps (of one step, with two): the
difference, divided by 2^p - 1 of order p, is the error of the steps (Richardson). In time a run
with a quarter of the steps bounds it, and one with an eighth where the changes are small and do not
decrease. Once more with these steps in the lifted element: the difference to the same run of the
own element is the error of the mesh. In time it is another one with other steps, as both motions
are out of phase: a lifted run with a quarter of the steps shows by how much. Where there are
penalties, once more with stiffer ones: their error is inverse to the stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cache
from math import ceil, inf
from time import perf_counter
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.cross_points import check_cross_points
from fem_snh.accuracy.differences import (
    STIFFER,
    penalty_part,
    saturation,
    scales_of,
    values_of,
    without_penalties,
)
from fem_snh.accuracy.estimate import Announce, announce_cost, estimating, locks
from fem_snh.accuracy.goal_errors import (
    LOAD_STEPS,
    TIME_STEPS,
    ElementDoesNotFit,
    Estimate,
    NoEstimate,
    StepsTooLong,
    check_shapes,
)
from fem_snh.accuracy.goals import Goal, bind_all, names_of
from fem_snh.accuracy.lift import (
    element_of_factor,
    lifted_elements,
)
from fem_snh.assembly.elements import Element
from fem_snh.errors import BadInput
from fem_snh.mesh.mesh import Mesh
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]

#: The order of time steps with contact, whose beginning and end fall between steps, and that of
#: load steps, whose friction acts along the chord of a step.
_CONTACT_ORDER = 1
#: Fewest time steps of which half are worth comparing.
_FEWEST_STEPS = 4
#: Fewest time steps of which the order is measured, and those that resolve a motion well enough
#: that the errors of mesh and penalties are measured with them: with 50 and 100 steps of a bounce
#: that of the mesh differs by a tenth.
_FEWEST_QUARTER, _ENOUGH_STEPS = 4, 100
#: Time steps are a multiple of this where half and a quarter of them show the order of their error.
HALVES = 4
#: Two estimates of a penalty's error agree if one is less than so many times the other.
_AGREE = 2.0
#: The bound of an error over the larger change where changes do not decrease.
_IRREGULAR = 2.0
#: Changes up to this part of a goal's scale bound the error where they do not decrease, if a third
#: one, by the first refinement of three, is not more than four times as large.
_SMALL_CHANGES = 0.05
#: Two refinements of order 1 divide a change by this.
_LEFT_BY_TWO = 4.0
#: Bounds that differ by this part are the same.
_DIGIT = 1e-9
#: Changes below this part of a goal's scale are not those of steps: the solvers leave that much.
_ROUNDING = 1e-5
#: What parts miss below this part of a goal's scale is no reason to find them again.
_NEGLIGIBLE = 1e-3
#: Part of a motion, up to its end, whose largest differences bound those at the end: errors of a
#: vibration change their sign, and are small at an instant by chance. Loads are compared rounded.
_LATE, _DIGITS = 0.5, 9
#: The bound of what the error of penalties misses, over the difference of two estimates of it that
#: do not agree.
_DISAGREEMENT = 2.0
#: The least ratio of the numbers of steps that are compared.
_LEAST_RATIO = 1.5


#: Returns a ``with`` block with the steps of a path from its beginning: with so many, in another
#: element, and with penalties so many times stiffer.
Repeat = Callable[[int, Element | None, float], AbstractContextManager[Any]]


class Path:
    """The path to the state of a problem, which can be followed again from its beginning.

    Parameters
    ----------
    stepper : Stepper
        Its steps.
    repeat : callable
        Begins it again.
    """

    def __init__(self, stepper: Any, repeat: Repeat) -> None:
        self._stepper, self._repeat = stepper, repeat

    @property
    def steps(self) -> int:
        """The given number of steps; it raises NoEstimate unless they are equal and are done."""
        if self._stepper.motion and self._stepper.motion.tolerance is not None:
            raise NoEstimate(
                "time.tolerance: expected equal time steps, of which half are compared"
            )
        if not self._stepper.done:
            raise NoEstimate("the steps have not reached their end")
        return int(self._stepper.steps)

    @property
    def taken(self) -> int:
        """The number of steps taken, which is larger where some failed and were halved."""
        return int(self._stepper.taken)

    def follow(
        self, steps: int, goals: Sequence[Goal], element: Element | None, stiffer: float
    ) -> Followed:
        """Follow the path in so many steps, by default with the run's element. Collective.

        Penalties are so many times ``stiffer`` than those of the run.

        Raises
        ------
        NoEstimate
            If the element does not fit, or the path does not reach its end.
        """
        name = (element or self._stepper.problem.element).name
        try:
            with self._repeat(steps, element, stiffer) as stepper:
                return end_of(stepper, stepper.problem, goals, f"with {steps} steps of {name}")
        except BadInput as error:  # a material without a volume term, a term of a program's own
            raise ElementDoesNotFit(f"{name} does not fit: {error}") from None


class Followed(NamedTuple):
    """The goals at the end of a path, the number of its steps, and what they cost.

    Attributes
    ----------
    values : (goals,) array
        The goals at the end.
    taken, newton, linear : int
        The steps taken, and their iterations.
    late : mapping of array
        The goals after the steps of the last half of the path, by the load.
    saturation : float
        The factor of `fem_snh.accuracy.differences` at the end, of an element of degree 3.
    """

    values: Array
    taken: int
    newton: int
    linear: int
    late: Mapping[float, Array] = MappingProxyType({})
    saturation: float = 1.0

    def largest_difference(self, other: Followed) -> Array:
        """Return the largest differences to another path at common loads, the end among them."""
        loads = self.late.keys() & other.late.keys()
        late = [abs(self.late[load] - other.late[load]) for load in loads]
        return np.max([abs(self.values - other.values), *late], axis=0)


def end_of(stepper: Any, problem: Problem, goals: Sequence[Goal], what: str) -> Followed:
    """Return the goals at the end of the steps of a `fem_snh.steps.stepping.Stepper`. Collective.

    Raises
    ------
    NoEstimate
        If they do not reach it, or a goal is not finite there.
    """
    newton = linear = 0
    evaluate, late = bind_all(goals, problem), dict[float, Array]()
    for row in stepper:
        newton += row["newton"]
        linear += row["linear"]
        if problem.motion and row["converged"] and problem.load >= 1 - _LATE:
            late[round(problem.load, _DIGITS)] = evaluate()
    if not stepper.done:
        raise StepsTooLong(f"{what}: {stepper.failure_message()}")
    values = evaluate()
    if not np.isfinite(values).all():
        raise NoEstimate(f"a goal is not finite {what}")
    factor = saturation(problem, problem.split(problem.x)[0]) if problem.motion else 1.0
    return Followed(values, stepper.taken, newton, linear, late, factor)


def estimate_on_path(
    problem: Problem,
    path: Path,
    goals: Sequence[Goal],
    announce: Announce = lambda estimate: None,
    mesh: Mesh | None = None,
    max_memory: float = inf,
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
    max_memory : float, optional
        The memory that the lifted problem may have [bytes].
    """

    with estimating(problem, goals, mesh) as estimate:
        check_cross_points(problem)
        check_shapes(problem)
        steps = path.steps
        if problem.motion and steps < _FEWEST_STEPS:
            raise NoEstimate(f"{steps} time steps: expected at least {_FEWEST_STEPS}")
        estimate.again = ceil(steps / 2) if steps > 1 else 2
        announce_cost(problem, _lifted_elements(problem)[:1], estimate, announce, max_memory)
        _Repetitions(problem, path, goals, estimate).add()
    return estimate


class _Repetitions:
    """The errors of goals at the end of a path, which is followed again. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at the end of the path.
    path : Path
        How it came there.
    goals : sequence of Goal
        The goals.
    estimate : Estimate
        Has their values and the number of steps of the first repetition, and counts iterations.

    Attributes
    ----------
    of_mesh : (goals,) array
        A bound of what shorter steps change of the part of the mesh.
    of_penalty : (goals,) array
        A bound of what the part of penalties misses, as time steps do not resolve them.
    largest : (goals,) array
        The largest part of the mesh in the last half of a motion.
    of_steps : (goals,) array
        The bound of the part of the steps where it is more than they leave with order 1: changes
        that do not decrease, of different signs, or small at the end by chance. Else 0.
    """

    def __init__(
        self, problem: Problem, path: Path, goals: Sequence[Goal], estimate: Estimate
    ) -> None:
        self._problem, self._path, self._goals, self._estimate = problem, path, goals, estimate
        self._values, self._scales = values_of(estimate, goals), scales_of(estimate, goals)
        self._known: dict[tuple[int, str, float], Followed] = {}
        zeros = np.zeros((4, len(self._values)))
        self.of_mesh, self.of_penalty, self.largest, self.of_steps = zeros

    def add(self) -> None:
        """Add the errors to the estimate; raise NoEstimate if there are none."""
        parts, goals = self.parts(), self._estimate.goals
        for i, name in enumerate(names_of(self._goals)):
            of_goal = {source: float(errors[i]) for source, errors in parts.items()}
            if goals[name].reason:
                of_goal.pop(_source(self._problem))
                goals[name] = replace(goals[name], parts=of_goal)
                continue
            of_mesh, penalty = float(self.of_mesh[i]), float(self.of_penalty[i])
            goals[name] = replace(
                goals[name],
                error=sum(of_goal.values()),
                parts=of_goal,
                unsettled=float(self.of_steps[i]) + of_mesh + penalty,
                mesh_bound=of_mesh,
                penalty_bound=penalty,
                of_path=float(self.largest[i]),
            )

    def parts(self) -> dict[str, Array]:
        """Return the parts of the errors by their source; of the steps alone if no goal has more.

        Raises
        ------
        NoEstimate
            If there are none.
        """
        problem, estimate, half_steps = self._problem, self._estimate, self._estimate.again
        half = self._follow(half_steps)
        finer = self._path.taken / half.taken  # with more steps than in the run, of one step, < 1
        if 1 / _LEAST_RATIO < finer < _LEAST_RATIO:
            raise StepsTooLong(
                f"with half the steps some failed and were halved: {half.taken} steps beside the "
                f"run's {self._path.taken} are no comparison"
            )
        quarter_steps = ceil(half_steps / 2)
        quarter = self._quarter(quarter_steps, half)
        before = half.values - quarter.values if quarter else np.zeros(len(self._values))
        self._note_what_is_left_out(before)
        parts = {_source(problem): self._errors_of_steps(half, finer, before, quarter)}
        if all(estimate.goals[name].reason for name in names_of(self._goals)):
            return parts
        if quarter and quarter_steps >= _ENOUGH_STEPS:
            fewer = ceil(quarter_steps / 2)
            others = self._errors_of_mesh_and_penalties(quarter_steps, quarter, fewer)
            if not self._miss_more_than_they_find(others):
                return parts | others
        start, fewer = perf_counter(), quarter_steps if quarter else 0
        others = self._errors_of_mesh_and_penalties(half_steps, half, fewer)
        if fewer >= _ENOUGH_STEPS:
            estimate.repeated = perf_counter() - start
        return parts | others

    def _follow(self, steps: int, element: Element | None = None, stiffer: float = 1.0) -> Followed:
        """Follow the path once, and count the iterations."""
        key = steps, element.name if element else "", stiffer
        if key not in self._known:
            again = self._path.follow(steps, self._goals, element, stiffer)
            self._estimate.newton += again.newton
            self._estimate.linear += again.linear
            self._known[key] = again
        return self._known[key]

    def _quarter(self, steps: int, half: Followed) -> Followed | None:
        """Return the motion with a quarter of the steps; None if that shows no order."""
        if not self._problem.motion or steps < _FEWEST_QUARTER or 2 * steps != self._estimate.again:
            return None
        quarter = self._follow(steps)
        return quarter if 2 * quarter.taken == half.taken else None

    def _note_what_is_left_out(self, before: Array) -> None:
        """Note an order that is not measured, and lengths that the lifted element has, too."""
        motion, left_out = self._problem.motion, self._estimate.left_out
        if motion and not before.any():
            steps, fewest = self._path.steps, HALVES * _FEWEST_QUARTER
            shows = f"a multiple of {HALVES} steps, {fewest} or more, shows it"
            if steps % HALVES == 0 and steps >= fewest:
                shows = "of a quarter of them some failed and were halved: more steps show it"
            left_out.append(
                f"the order of {self._path.taken} time steps was not measured: their error may be "
                f"larger than its estimate, which takes order {motion.integrator.order}; {shows}"
            )
        for term in self._problem.terms:
            if term.length_text:
                left_out.append(f"the errors do not include that of the gap: {term.length_text}")

    def _errors_of_steps(
        self, half: Followed, finer: float, before: Array, quarter: Followed | None
    ) -> Array:
        """Return the errors of the steps, and set their bounds.

        Parameters
        ----------
        half : Followed
            The path with half the steps.
        finer : float
            The steps of the run over those.
        before : (goals,) array
            The change from a quarter of the steps to half of them; zero without a ``quarter``.
        quarter : Followed or None
            The path with a quarter of the steps.
        """
        motion, change = self._problem.motion, self._values - half.values
        most = motion.integrator.order if motion else _CONTACT_ORDER
        touches = any(term.is_contact for term in self._problem.terms)
        least = _CONTACT_ORDER if touches else most
        rounding, limits = _ROUNDING * self._scales, _SMALL_CHANGES * self._scales
        errors, bounds = steps_errors(change, before, finer, (least, most), rounding)
        if quarter:
            late = half.largest_difference(quarter)
            bounds = np.maximum(bounds, late / finer**most)
        unordered = (bounds == inf) & (np.maximum(abs(change), abs(before)) <= limits)
        eighth_steps = ceil(self._estimate.again / 4)
        if quarter and unordered.any() and eighth_steps >= _FEWEST_QUARTER:
            eighth = self._follow(eighth_steps)
            if eighth.taken == eighth_steps:
                changes = np.array([change, before, quarter.values - eighth.values])
                small = bounds_of_small_changes(changes, limits, most)
                bounds = np.where(unordered, small, bounds)
        more = bounds > (1 + _DIGIT) * np.abs(change) / abs(finer - 1)
        self.of_steps = np.where(more, bounds, 0.0)
        goals = self._estimate.goals
        for i, (name, bound) in enumerate(zip(names_of(self._goals), bounds, strict=True)):
            reason = _no_order(before[i], change[i]) if bound == inf else ""
            goals[name] = replace(goals[name], steps_bound=float(bound), reason=reason)
        return errors

    def _errors_of_mesh_and_penalties(
        self, steps: int, followed: Followed, fewer: int
    ) -> dict[str, Array]:
        """Return these parts with so many steps, and set what they miss.

        Parameters
        ----------
        steps : int
            The number of steps.
        followed : Followed
            The path with them.
        fewer : int
            A smaller number of them; 0: none.
        """
        values, motion = followed.values, self._problem.motion
        has_penalties = self._problem.scale_penalties(1.0)

        @cache
        def stiffened(factor: float) -> Array:
            return self._follow(steps, stiffer=factor).values if factor != 1 else values

        penalty, stiffer = None, 1.0
        if has_penalties and not motion:
            try:
                penalty = without_penalties(values, self._scales, stiffened, verify=False)
                stiffer = STIFFER  # most of the error that the mesh has without penalties
            except NoEstimate as error:
                self._estimate.left_out.append(f"the error of penalties is not known: {error}")
        lifted, element = self._lifted(steps, stiffer)
        difference = lifted.values - stiffened(stiffer)
        mesh = difference
        if motion:
            mesh = difference + self._missed_by_lifted(steps, lifted, element, difference)
            factor = self._estimate.saturation
            late = lifted.largest_difference(followed)
            self.largest = np.maximum(np.abs(mesh), factor * late)
            self.of_mesh = factor * self._change_by_steps(difference, element, fewer)
        if has_penalties and motion:
            by_stiffer = penalty_part(values, stiffened(STIFFER))
            by_softer = penalty_part(stiffened(1 / STIFFER), values) / STIFFER
            penalty, self.of_penalty = resolved_penalty(by_stiffer, by_softer)
        parts = {"mesh": mesh}
        return parts if penalty is None else parts | {"penalty": penalty}

    def _miss_more_than_they_find(self, parts: dict[str, Array]) -> bool:
        """Return whether the steps are too long for the errors of the mesh and of penalties."""
        found = np.sum([np.abs(part) for part in parts.values()], axis=0)
        missed = self.of_mesh + self.of_penalty
        return bool((missed > np.maximum(found, _NEGLIGIBLE * self._scales)).any())

    def _missed_by_lifted(
        self, steps: int, lifted: Followed, element: Element, difference: Array
    ) -> Array:
        """Return what the lifted element misses in time, from the decay of its degrees.

        Parameters
        ----------
        steps : int
            The number of steps.
        lifted : Followed
            The path with them in the lifted element.
        element : Element
            The lifted element.
        difference : (goals,) array
            Its goals less those of the run's element.
        """
        middle = element_of_factor(self._problem, element)
        if middle is None and locks(self._problem, element):
            return np.zeros(len(difference))
        self._estimate.saturation = lifted.saturation
        if lifted.saturation > 1 and middle is not None:
            difference = lifted.values - self._follow(steps, middle).values
        return (lifted.saturation - 1) * difference

    def _change_by_steps(self, mesh: Array, element: Element, steps: int) -> Array:
        """Return by how much the part of the mesh differs with fewer steps; 0 without any.

        Shorter steps change it by no more, if the difference decreases as with order 1.
        """
        if not steps:
            return np.zeros(len(mesh))
        try:
            followed, lifted = self._follow(steps), self._follow(steps, element)
        except NoEstimate as error:
            self._estimate.left_out.append(
                f"what shorter time steps change of the error of the mesh is not known: {error}"
            )
            return np.zeros(len(mesh))
        return np.abs(mesh - (lifted.values - followed.values))

    def _lifted(self, steps: int, stiffer: float) -> tuple[Followed, Element]:
        """Return the path in the best lifted element that fits, and that element."""
        *others, last = _lifted_elements(self._problem)
        for element in others:
            self._estimate.element = element.name
            try:
                return self._follow(steps, element, stiffer), element
            except ElementDoesNotFit:
                continue
        self._estimate.element = last.name
        return self._follow(steps, last, stiffer), last


def bounds_of_small_changes(changes: Array, limits: Array, order: int) -> Array:
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


def resolved_penalty(by_stiffer: Array, by_softer: Array) -> tuple[Array, Array]:
    """Return errors of penalties in time, from stiffer and from softer ones, and what they miss.

    Both are about the same where the time steps resolve the vibration of the stiffer ones.
    Elsewhere the softer ones have the right one, unless they yield too much: twice the difference
    bounds what is missed.
    """
    agree = np.sign(by_stiffer) == np.sign(by_softer)
    agree &= np.abs(by_stiffer) < _AGREE * np.abs(by_softer)
    agree &= np.abs(by_softer) < _AGREE * np.abs(by_stiffer)
    missed = np.where(agree, 0.0, _DISAGREEMENT * np.abs(by_stiffer - by_softer))
    return np.where(agree, by_stiffer, by_softer), missed


def steps_errors(
    change: Array,
    before: Array,
    finer: float,
    orders: Sequence[int],
    rounding: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Return the errors of the steps of goals, and bounds of them.

    The order is measured by both changes where there is one ``before``. Steps that hardly resolve
    the motion have any order, and a change may be small by chance: the bound is the error with
    order 1, and at least what the change before leaves at the largest order, or at order 1 if both
    have different signs. Changes that decrease slower than with order 1 say nothing of the sign:
    the error is zero, and the bound is twice the larger change. Where they do not decrease, both
    may be small by chance, and further ones of any size: the bound is infinite; see
    `bounds_of_small_changes`.

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
    left_of_first = np.where(change * before < 0, finer**_CONTACT_ORDER, most)
    bound = np.maximum(last / abs(finer - 1), first / left_of_first)
    irregular = (first > 0) & (first < finer**_CONTACT_ORDER * last)
    bound = np.where(irregular, _IRREGULAR * np.maximum(last, first), bound)
    bound = np.where(irregular & (first <= last) & (last > rounding), inf, bound)
    return np.where(irregular, 0.0, error), bound
