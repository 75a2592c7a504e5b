"""Estimate the errors of goals whose end depends on the path: the path is followed again.

In time, or with load steps of friction. With half and a quarter of the steps, which measure the
error of the steps; with half of them (of a motion of many, a quarter) in the lifted element, whose
difference to the same run of the own element is the error of the mesh; and where there are
penalties, with softer or stiffer ones. `fem_snh.accuracy.effectivity` has the rule of all three.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from math import ceil
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.linalg import norm

from fem_snh.accuracy.differences import saturation
from fem_snh.accuracy.effectivity import MISSED, of_order
from fem_snh.accuracy.estimate import (
    EstimateOptions,
    announce_cost,
    estimating,
    set_parts,
    with_missed,
)
from fem_snh.accuracy.goal_errors import (
    LOAD_STEPS,
    TIME_STEPS,
    Estimate,
    NoEstimate,
    StepsTooLong,
    check_shapes,
)
from fem_snh.accuracy.lift import first_that_fits, lifted_elements
from fem_snh.accuracy.penalties import STIFFER, without_penalties
from fem_snh.arrays import Array
from fem_snh.assembly.elements import Element
from fem_snh.choices import LARGEST, LOAD_DIGITS
from fem_snh.problem.goals import Goal, bind_all, is_as_far, slices_of
from fem_snh.problem.problem import Problem

#: The number of a path's steps is a multiple of this where half and a quarter of them measure their
#: error; and fewer time steps, in half or in a quarter of them, resolve no motion.
HALVES = 4
#: Fewest steps that resolve a motion well enough that the errors of mesh and penalties are measured
#: with them: with 50 and 100 steps of a bounce that of the mesh differs by a tenth.
_ENOUGH_STEPS = 100
#: The least ratio of the numbers of steps that are compared: halfway from none to half of them.
_LEAST_RATIO = 1.5


#: Returns a ``with`` block with the steps of a path from its beginning: with so many, in another
#: element, and with penalties so many times stiffer.
Repeat = Callable[[int, Element | None, float], AbstractContextManager[Any]]


#: Where a goal of a path is evaluated: at its end, at a load, or where it is farthest from its
#: value at the start.
At = float | str | None


class GoalHistory:
    """The goals of a problem at the beginning of a path and after its steps. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, at the beginning.
    goals : sequence of Goal
        The goals.

    Attributes
    ----------
    values : dict of (scalars,) array
        The goals by the load, rounded.
    saturation : float
        The factor of `fem_snh.accuracy.differences` at the end of a motion; 1 without inertia.
    """

    def __init__(self, problem: Problem, goals: Sequence[Goal]) -> None:
        self._problem, self._evaluate = problem, bind_all(goals, problem)
        self.values: dict[float, Array] = {}
        self.saturation = 1.0
        self.add()

    def add(self) -> None:
        """Add the goals at the present load: the same on all ranks, which compare them."""
        values = self._problem.comm.bcast(self._evaluate())
        self.values[round(self._problem.load, LOAD_DIGITS)] = values

    @property
    def taken(self) -> int:
        """The steps taken, where some may have failed and been halved."""
        return len(self.values) - 1

    def at(self, load: float) -> Array:
        """Return the goals at a load; between steps by a cubic spline, as lines cut corners."""
        if load in self.values:
            return self.values[load]
        from scipy.interpolate import CubicSpline

        loads = sorted(self.values)
        return np.asarray(CubicSpline(loads, [self.values[each] for each in loads])(load))

    def load_of(self, part: slice, at: At) -> float:
        """Return the load at which a goal, a ``part`` of the scalars, is evaluated."""
        if at is None:
            return 1.0
        if at != LARGEST:
            return round(float(at), LOAD_DIGITS)
        start = self.values[0.0][part]
        sizes = {load: float(norm(values[part] - start)) for load, values in self.values.items()}
        farthest, size_at_start = max(sizes.values()), float(norm(start))
        return max(load for load, size in sizes.items() if is_as_far(size, farthest, size_at_start))


@dataclass(frozen=True)
class Path:
    """The path to the state of a problem, which can be followed again from its beginning.

    Attributes
    ----------
    stepper : Stepper
        Its steps.
    repeat : callable
        Begins it again.
    history : GoalHistory, optional
        The goals along it; default: it is followed again for them.
    """

    stepper: Any
    repeat: Repeat
    history: GoalHistory | None = None

    @property
    def steps(self) -> int:
        """The given number of steps; it raises NoEstimate unless they are equal and are done."""
        if self.stepper.motion and self.stepper.motion.tolerance is not None:
            raise NoEstimate(
                "time.tolerance: expected equal time steps, of which half are compared"
            )
        if not self.stepper.done:
            raise NoEstimate("the steps have not reached their end")
        return int(self.stepper.steps)


def estimate_on_path(
    problem: Problem,
    path: Path,
    goals: Sequence[Goal],
    options: EstimateOptions = EstimateOptions(),
    at: Mapping[Goal, At] = MappingProxyType({}),
) -> Estimate:
    """Return the errors of goals of a motion, or of load steps. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at the end of the path; its state is unchanged.
    path : Path
        How it came there.
    goals : sequence of Goal
        The goals.
    options : EstimateOptions, optional
        What the estimate is for.
    at : mapping, optional
        Where goals are evaluated that are not at the end: see `At`.
    """
    with estimating(problem, goals, options.mesh) as estimate:
        check_shapes(problem)
        steps = path.steps
        if problem.motion and steps < HALVES:
            raise NoEstimate(f"{steps} time steps: expected at least {HALVES}")
        estimate.again = ceil(steps / 2) if steps > 1 else 2
        announce_cost(problem, _lifted_elements(problem)[:1], estimate, options)
        _Repetitions(problem, path, goals, estimate, at).add()
    return estimate


def values_on_path(
    problem: Problem, path: Path, goals: Sequence[Goal], at: Mapping[Goal, At]
) -> Estimate:
    """Return goals without errors, where they are evaluated; see `estimate_on_path`. Collective."""
    with estimating(problem, goals) as estimate:
        _Repetitions(problem, path, goals, estimate, at).set_values()
    return estimate


@dataclass(frozen=True)
class _Repetitions:
    """The errors of goals along a path, which is followed again. Collective.

    Attributes
    ----------
    problem : Problem
        The problem at the end of the path.
    path : Path
        How it came there.
    goals : sequence of Goal
        The goals.
    estimate : Estimate
        Has their values and the number of steps of the first repetition.
    at : mapping
        Where goals are evaluated.
    """

    problem: Problem
    path: Path
    goals: Sequence[Goal]
    estimate: Estimate
    at: Mapping[Goal, At]

    @cached_property
    def run(self) -> GoalHistory:
        """The path as the run followed it."""
        return self.path.history or self._follow(self.path.steps)

    @property
    def _parts(self) -> list[tuple[slice, At]]:
        """The scalars of each goal, and where it is evaluated."""
        return list(zip(slices_of(self.goals), map(self.at.get, self.goals), strict=True))

    def _follow(
        self, steps: int, element: Element | None = None, stiffer: float = 1.0
    ) -> GoalHistory:
        """Follow the path in so many steps, by default with the run's element. Collective.

        Penalties are so many times ``stiffer`` than those of the run.

        Raises
        ------
        BadInput
            If the element does not fit.
        NoEstimate
            If the steps do not reach their end, or a goal is not finite.
        """
        with self.path.repeat(steps, element, stiffer) as stepper:
            problem = stepper.problem
            history = GoalHistory(problem, self.goals)
            what = f"with {steps} steps of {problem.element.name}"
            for row in stepper:
                self.estimate.newton += row["newton"]
                self.estimate.linear += row["linear"]
                if row["converged"]:
                    history.add()
            if not stepper.done:
                raise StepsTooLong(f"{what}: {stepper.failure_message()}")
            if not all(np.isfinite(values).all() for values in history.values.values()):
                raise NoEstimate(f"a goal is not finite {what}")
            if problem.motion:
                history.saturation = saturation(problem, problem.split(problem.x)[0])
            return history

    def add(self) -> None:
        """Add the errors to the estimate.

        Raises
        ------
        NoEstimate
            If there are none.
        """
        run, estimate = self.run, self.estimate
        steps, terms, motion = estimate.again, self.problem.terms, self.problem.motion
        self.set_values()
        followed = self._follow(steps)
        ratio = run.taken / followed.taken  # below 1 where the run has one step
        if 1 / _LEAST_RATIO < ratio < _LEAST_RATIO:
            raise StepsTooLong(
                f"with half the steps some failed and were halved: {followed.taken} steps beside "
                f"the run's {run.taken} are no comparison"
            )
        paths, fewer = [followed, run], ceil(steps / 2)
        if fewer >= HALVES and 2 * fewer == steps:
            quarter = self._follow(fewer)
            if 2 * quarter.taken == followed.taken:  # none failed
                paths.insert(0, quarter)
        # Contact begins and ends between time steps; friction acts along the chord of a load step.
        touches = any(term.is_contact for term in terms)
        order = motion.integrator.order if motion and not touches else 1
        powers = [(fine.taken / coarse.taken) ** order for coarse, fine in pairwise(paths)]
        parts = {TIME_STEPS if motion else LOAD_STEPS: self._of_order(paths, powers)}
        gaps = [term.length_text for term in terms if term.length_text]
        estimate.left_out += [f"the errors do not include that of the gap: {gap}" for gap in gaps]
        if len(paths) > 2 and fewer >= _ENOUGH_STEPS:
            steps, followed = fewer, paths[0]
        parts["mesh"] = self._of_mesh(steps, followed)
        if self.problem.scale_penalties(1.0):  # not of a barrier alone, whose gap is left out
            try:
                parts["penalty"] = self._of_penalties(steps, followed)
            except NoEstimate as error:
                if motion:
                    raise
                estimate.left_out.append(f"the error of penalties is not known: {error}")
        set_parts(estimate, self.goals, parts)

    def set_values(self) -> None:
        """Set the values of goals, and their loads, where they are not at the end."""
        goals, loads = self.estimate.goals, self.estimate.loads
        for goal, (part, at) in zip(self.goals, self._parts, strict=True):
            if (load := self.run.load_of(part, at)) == 1:
                continue
            values = dict(zip(goal.names, map(float, self.run.at(load)[part]), strict=True))
            scale = max(abs(values[name]) for name in goal.asked)
            for name, value in values.items():
                goals[name] = replace(goals[name], value=value, scale=scale or goals[name].scale)
                loads[name] = load

    def _ends(self, path: GoalHistory) -> Array:
        """Return the goals of a path where they are evaluated, (scalars,)."""
        values = [path.at(path.load_of(part, at))[part] for part, at in self._parts]
        return np.concatenate(values)

    def _late(self, paths: Sequence[GoalHistory]) -> Iterator[list[Array]]:
        """Yield each goal late on the paths, and where it is evaluated: (instants, n) of each path.

        Late is the second half of the way: errors of a vibration change their sign, and are small
        at an instant by chance.
        """
        common = set(paths[0].values).intersection(*(path.values for path in paths[1:]))
        for part, at in self._parts:
            ends = [path.load_of(part, at) for path in paths]
            loads = sorted(load for load in common if min(ends) / 2 <= load < min(ends))
            yield [
                np.array([path.at(load)[part] for load in (*loads, end)])
                for path, end in zip(paths, ends, strict=True)
            ]

    def _of_order(
        self, paths: Sequence[GoalHistory], powers: Sequence[float]
    ) -> tuple[Array, Array]:
        """Return what is to be added to the goals of the last path, and what it may miss.

        At its end an error of a vibration may be as large as at any late instant.
        """
        errors, missed = [], []
        for values in self._late(paths):
            found = of_order([instants.ravel() for instants in values], powers)
            error, bounds = (each.reshape(values[0].shape) for each in found)
            errors.append(error[-1])
            missed.append(bounds.max(axis=0))
        return np.concatenate(errors), np.concatenate(missed)

    def _of_mesh(self, steps: int, followed: GoalHistory) -> tuple[Array, Array]:
        """Return the error of the mesh in a path with so many steps, and what that may miss.

        In time, too, the decay of the lifted element's degrees says what it misses.
        """
        problem, estimate, values = self.problem, self.estimate, self._ends(followed)
        element, lifted = first_that_fits(_lifted_elements(problem), partial(self._follow, steps))
        estimate.element = element.name
        mesh, estimate.saturation = with_missed(
            problem,
            element,
            lifted.saturation,
            self._ends(lifted) - values,
            lambda middle: self._ends(self._follow(steps, middle)) - values,
        )
        late = [np.abs(better - own).max(axis=0) for better, own in self._late([lifted, followed])]
        largest = estimate.saturation * np.concatenate(late)
        return mesh, MISSED * np.maximum(np.abs(mesh), largest)

    def _of_penalties(self, steps: int, followed: GoalHistory) -> tuple[Array, Array]:
        """Return the error of penalties in a path with so many steps, and what that may miss."""
        values = self._ends(followed)
        if self.problem.motion:  # whose steps may not resolve the vibration of stiffer ones
            soft, stiff = (self._follow(steps, stiffer=f) for f in (1 / STIFFER, STIFFER))
            left, missed = self._of_order([soft, followed, stiff], [STIFFER, STIFFER])
            return self._ends(stiff) + left - values, missed
        return without_penalties(
            self.goals,
            values,
            self.estimate.scales(self.goals),
            lambda factor: self._ends(self._follow(steps, stiffer=factor)),
        )


def _lifted_elements(problem: Problem) -> list[Element]:
    """Return the elements of the lifted runs, of which the first one that fits is taken.

    Where the elements do not lock, one of degree 3 without a pressure: its matrix is definite, and
    each of many steps costs a fraction.
    """
    elements = list(lifted_elements(problem))
    definite = elements[-1].volume == problem.element.volume == "pointwise"
    return elements[-1:] if definite and problem.element.degree > 1 else elements
