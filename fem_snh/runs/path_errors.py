"""Estimate the errors of a scene whose end depends on its path: the path is followed again.

In time, or with load steps of friction. Once with half the steps (of one step, with two): the
difference, divided by 2^p - 1 of order p, is the error of the steps (Richardson). In time a run
with a quarter of the steps bounds it. Once more with these steps in the lifted element: the
difference to the same run of the own element is the error of the mesh. Where there are penalties,
once more with stiffer ones: their error is inverse to the stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil, inf
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import scenes
from fem_snh.accuracy.budget import STIFFER, penalty_part
from fem_snh.accuracy.estimate import (
    LOAD_STEPS,
    TIME_STEPS,
    Estimate,
    bounded_steps,
    estimated,
)
from fem_snh.accuracy.frequency_goals import FrequencyGoal
from fem_snh.accuracy.goals import Goal, names_of
from fem_snh.accuracy.lift import (
    NoEstimate,
    check_body,
    check_memory,
    lifted_dofs,
    lifted_elements,
    memory,
)
from fem_snh.assembly.elements import Element
from fem_snh.errors import BadInput
from fem_snh.problem.problem import Problem
from fem_snh.runs.setup import Setup, set_up

#: The order of time steps with contact, whose beginning and end fall between steps, and that of
#: load steps, whose friction acts along the chord of a step.
_CONTACT_ORDER = 1
#: Fewest time steps of which half are worth comparing.
_FEWEST_STEPS = 4
#: Fewest time steps of which the order is measured, and those that resolve a motion well enough
#: that the errors of mesh and penalties are measured with them: with 50 and 100 steps of a bounce
#: that of the mesh differs by a tenth.
_FEWEST_QUARTER, _ENOUGH_STEPS = 4, 100
#: Two estimates of a penalty's error agree if one is less than so many times the other.
_AGREE = 2.0
#: The bound of an error over the larger change where changes do not decrease.
_IRREGULAR = 2.0
#: Changes below this part of a goal's scale are not those of steps: the solvers leave that much.
_ROUNDING = 1e-5
#: The least ratio of the numbers of steps that are compared.
_LEAST_RATIO = 1.5


def estimate_on_path(
    comm: MPI.Comm,
    scene: scenes.Scene,
    setup: Setup,
    goals: Sequence[Goal],
    announce: Callable[[Estimate], None],
) -> Estimate:
    """Return the errors of goals at the end of a motion, or of load steps. Collective.

    The parameters are those of `fem_snh.runs.estimates.estimate_errors`.
    """

    def find(found: Estimate) -> None:
        known = [goal for goal in goals if not isinstance(goal, FrequencyGoal)]
        found.on_no_mesh = len(known) < len(goals)
        parts = _errors(comm, scene, setup, known, found, announce)
        for i, name in enumerate(names_of(known)):
            own = {part: float(errors[i]) for part, errors in parts.items()}
            goal = found.goals[name]
            if goal.reason:
                own.pop(_source(scene))
                found.goals[name] = replace(goal, parts=own)
                continue
            # Irregular steps have no estimate: the error is printed as a bound.
            unsettled = goal.steps_bound if bounded_steps(own, goal.steps_bound) else 0.0
            error = sum(own.values())
            found.goals[name] = replace(goal, error=error, parts=own, unsettled=unsettled)

    return estimated(setup.problem, goals, find)


def _errors(
    comm: MPI.Comm,
    scene: scenes.Scene,
    setup: Setup,
    goals: Sequence[Goal],
    found: Estimate,
    announce: Callable[[Estimate], None],
) -> dict[str, npt.NDArray[Any]]:
    """Return the errors of steps, mesh and penalties; raise NoEstimate if there are none."""
    problem, steps = setup.problem, _steps(scene)
    check_body(problem)
    element = _lifted_element(problem)
    found.element, found.dofs = element.name, lifted_dofs(problem, element)
    found.memory, found.again = memory(problem, element), ceil(steps / 2) if steps > 1 else 2
    announce(found)
    check_memory(problem, found.memory)
    known = [found.goals[name] for name in names_of(goals)]
    values = np.array([goal.value for goal in known])
    half = _with_steps(scene, found.again)
    coarse, taken = _follow(comm, half, setup, goals, found)
    finer = setup.stepper.taken / taken  # with more steps than in the run, of one step, below 1
    if 1 / _LEAST_RATIO < finer < _LEAST_RATIO:
        raise NoEstimate(
            f"with half the steps some failed and were halved: {taken} steps beside the run's "
            f"{setup.stepper.taken} are no comparison"
        )
    before, few = np.zeros(len(values)), ceil(found.again / 2)
    on, at = half, coarse  # the run beside which those of the mesh and the penalties are
    if scene.time and few >= _FEWEST_QUARTER and 2 * few == found.again:
        quarter = _with_steps(scene, few)
        coarsest, number = _follow(comm, quarter, setup, goals, found)
        if 2 * number == taken:
            before = coarse - coarsest
            if few >= _ENOUGH_STEPS:
                on, at = quarter, coarsest
    motion = setup.stepper.motion
    orders = [_CONTACT_ORDER, motion.dynamics.integrator.order if motion else _CONTACT_ORDER]
    if motion and not (scene.obstacle or scene.contact or scene.self_contact):
        orders[0] = orders[1]
    rounding = np.array([_ROUNDING * goal.scale for goal in known])
    steps_error, found_bounds = steps_errors(values - coarse, before, finer, orders, rounding)
    for i, (name, bound) in enumerate(zip(names_of(goals), found_bounds, strict=True)):
        reason = _no_order(before[i], values[i] - coarse[i]) if bound == inf else ""
        found.goals[name] = replace(found.goals[name], steps_bound=float(bound), reason=reason)
    if all(found.goals[name].reason for name in names_of(goals)):
        return {_source(scene): steps_error}
    lifted, _ = _follow(comm, on, setup, goals, found, element)
    parts = {_source(scene): steps_error, "mesh": lifted - at}
    if problem.scale_penalties(1.0):  # there are some
        stiff, _ = _follow(comm, on, setup, goals, found, stiffer=STIFFER)
        parts["penalty"] = penalty_part(at, stiff)
        if scene.time:
            soft, _ = _follow(comm, on, setup, goals, found, stiffer=1 / STIFFER)
            parts["penalty"] = resolved_penalty(parts["penalty"], penalty_part(soft, at) / STIFFER)
    return parts


def _no_order(before: float, change: float) -> str:
    """Return why a goal has no estimate, with its changes by twice as many steps."""
    return (
        f"its changes do not decrease: twice as many time steps changed it by {before:+.2g}, and "
        f"twice as many again by {change:+.2g}"
    )


def _source(scene: scenes.Scene) -> str:
    """Return the name of the part of the errors that steps have."""
    return TIME_STEPS if scene.time else LOAD_STEPS


def _lifted_element(problem: Problem) -> Element:
    """Return the element of the lifted runs.

    Where the elements do not lock, one of degree 3 without a pressure: its matrix is definite, and
    each of many steps costs a fraction.
    """
    elements = list(lifted_elements(problem))
    definite = elements[-1].volume == problem.element.volume == "pointwise"
    return elements[-1] if definite and problem.element.degree > 1 else elements[0]


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
    ones of any size: the bound is infinite.

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


def _steps(scene: scenes.Scene) -> int:
    """Return the number of a scene's steps; raise NoEstimate if half are no comparison."""
    if scene.time is None:
        return scene.steps
    if scene.time.tolerance is not None:
        raise NoEstimate("time.tolerance: expected equal time steps, of which half are compared")
    if scene.time.steps < _FEWEST_STEPS:
        raise NoEstimate(f"time.steps = {scene.time.steps}: expected at least {_FEWEST_STEPS}")
    return scene.time.steps


def _with_steps(scene: scenes.Scene, steps: int) -> scenes.Scene:
    """Return a scene with another number of steps."""
    if scene.time is None:
        return scene.model_copy(update={"steps": steps})
    return scene.model_copy(update={"time": scene.time.model_copy(update={"steps": steps})})


def _follow(
    comm: MPI.Comm,
    scene: scenes.Scene,
    setup: Setup,
    goals: Sequence[Goal],
    found: Estimate,
    element: Element | None = None,
    stiffer: float = 1.0,
) -> tuple[npt.NDArray[Any], int]:
    """Return the goals at the end of the path on the same mesh, and the number of its steps.

    In another element if one is given.
    """
    name = element.name if element else scene.element
    if element and element.has_pressure:  # whose defaults are those of a saddle-point problem
        scene = scene.model_copy(update={"hessian": None, "globalization": None})
    try:
        stiffness = setup.stiffer * stiffer
        again = set_up(comm, scene, mesh=setup.mesh, element=element, stiffer=stiffness)
    except BadInput as error:  # a material without a volume term of its own
        raise NoEstimate(f"{name} does not fit: {error}") from None
    try:
        found.jit += again.seconds["jit"]
        for row in again.stepper:
            found.newton += row["newton"]
            found.linear += row["linear"]
        if not again.stepper.done:
            raise NoEstimate(
                f"with {found.again} steps of {name}: {again.stepper.failure_message()}"
            )
        values = np.array([v for goal in goals for v in goal.bind(again.problem)()])
    finally:
        again.destroy()
    if not np.isfinite(values).all():
        raise NoEstimate(f"a goal is not finite with {found.again} steps of {name}")
    return values, again.stepper.taken
