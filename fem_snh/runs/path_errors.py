"""Estimate the errors of a scene whose end depends on its path: the path is followed again.

In time, or with load steps of friction. Once with half the steps (of one step, with two): the
difference, divided by 2^p - 1 of order p, is the error of the steps (Richardson). Once more with
these steps in the lifted element: the difference to the second run is the error of the mesh. Where
there are penalties, once more with stiffer ones: their error is inverse to the stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import scenes
from fem_snh.accuracy.budget import STIFFER, penalty_part
from fem_snh.accuracy.estimate import Estimate, estimated
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
from fem_snh.runs.setup import Setup, set_up

#: The order of time steps with contact, whose beginning and end fall between steps, and that of
#: load steps, whose friction acts along the chord of a step.
_CONTACT_ORDER = 1
#: Fewest time steps of which half are worth comparing.
_FEWEST_STEPS = 4
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
            found.goals[name] = replace(found.goals[name], error=sum(own.values()), parts=own)

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
    element = next(lifted_elements(problem))
    found.element, found.dofs = element.name, lifted_dofs(problem, element)
    found.memory, found.again = memory(problem, element), ceil(steps / 2) if steps > 1 else 2
    announce(found)
    check_memory(problem, found.memory)
    values = np.array([found.goals[name].value for name in names_of(goals)])
    half = _with_steps(scene, found.again)
    coarse, taken = _follow(comm, half, setup, goals, found)
    finer = setup.stepper.taken / taken  # with more steps than in the run, of one step, below 1
    if 1 / _LEAST_RATIO < finer < _LEAST_RATIO:
        raise NoEstimate(
            f"with half the steps some failed and were halved: {taken} steps beside the run's "
            f"{setup.stepper.taken} are no comparison"
        )
    lifted, _ = _follow(comm, half, setup, goals, found, element)
    order = _CONTACT_ORDER
    if setup.stepper.motion and not (scene.obstacle or scene.contact or scene.self_contact):
        order = setup.stepper.motion.dynamics.integrator.order
    parts = {
        "time steps" if scene.time else "load steps": (values - coarse) / (finer**order - 1),
        "mesh": lifted - coarse,
    }
    if problem.scale_penalties(1.0):  # there are some
        stiff, _ = _follow(comm, half, setup, goals, found, stiffer=STIFFER)
        parts["penalty"] = penalty_part(coarse, stiff)
    return parts


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
