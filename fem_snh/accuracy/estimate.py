"""Estimate the errors of goals: their values in the lifted problem less those of the run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.accuracy.differences import SETTLED, Lift, saturation
from fem_snh.accuracy.effectivity import MISSED, OF_VECTOR
from fem_snh.accuracy.goal_errors import (
    NO_CONTACT,
    Estimate,
    GoalError,
    NoEstimate,
    NoEstimateOnAnyMesh,
    StepsTooLong,
    check_problem,
    check_shapes,
)
from fem_snh.accuracy.indicators import cell_indicators, place
from fem_snh.accuracy.lift import (
    available_memory,
    create_in,
    element_of_factor,
    first_that_fits,
    lifted_elements,
    memory,
)
from fem_snh.accuracy.penalties import penalty_errors
from fem_snh.arrays import Array
from fem_snh.assembly.elements import Element
from fem_snh.assembly.unknowns import num_unknowns
from fem_snh.cache import Stopwatch
from fem_snh.contact.obstacle_contact import ObstacleContact
from fem_snh.errors import in_words
from fem_snh.mesh.mesh import Mesh
from fem_snh.mesh.round_faces import round_faces
from fem_snh.problem.goals import Goal, StressGoal, TermGoal, names_of
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import is_at_rest

#: Goals are relative to the largest component of their vector that was asked for, or to this part
#: of the largest displacement or force, if that is more.
_LEAST_SCALE = 1e-3


@dataclass(frozen=True)
class EstimateOptions:
    """What an estimate is for.

    Attributes
    ----------
    matters : float
        The relative error that matters, of which 2 % may be unsettled: what is asked for, if it is.
    stability : bool
        Whether the stability of the lifted equilibrium is examined whatever it costs.
    locate_all : bool
        Whether the errors of all goals are distributed to the cells, each with a linear solve; else
        the largest relative error is.
    max_memory : float
        The memory that the lifted problem may have [bytes].
    mesh : Mesh or None
        The mesh of a scene, whose groups describe where the error is.
    announce : callable
        Called with the cost, before the errors are estimated.
    update : tuple or None
        That of ``snes.setUpdate``: a function that is called before each iteration, and its
        arguments and keywords.
    """

    matters: float = 5e-3
    stability: bool = False
    locate_all: bool = True
    max_memory: float = inf
    mesh: Mesh | None = None
    announce: Callable[[Estimate], None] = lambda estimate: None
    update: tuple[Callable[..., None], Any, Any] | None = None


def estimate_error(
    problem: Problem,
    make: Callable[[Element], Problem],
    goals: Sequence[Goal],
    options: EstimateOptions = EstimateOptions(),
) -> Estimate:
    """Return the errors of goals of a problem at its solution. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at its solution; its state is unchanged.
    make : callable
        Returns the same problem on the same mesh with another element.
    goals : sequence of Goal
        The goals.
    options : EstimateOptions, optional
        What the estimate is for.
    """
    with estimating(problem, goals, options.mesh) as estimate:
        check_problem(problem)
        check_shapes(problem)
        elements = list(lifted_elements(problem))
        used = [elements[0], element_of_factor(problem, elements[0])]
        announce_cost(problem, used, estimate, options)
        created_in = partial(create_in, problem=problem, make=make)
        element, lifted = first_that_fits(elements, created_in)
        of_penalties = penalty_errors(problem, goals, estimate, options.update)
        estimate.element = element.name
        with closing(Lift(problem, lifted, options.update)) as lift:
            values, unsettled = lift.differences(goals, estimate, options.matters)
            if lift.may_be_unstable(options.stability):
                estimate.left_out.append(
                    f"the state of {element.name} may be unstable, as iterations leave that open: "
                    "a scene's stability = true tells"
                )

            def in_middle(middle: Element) -> Array:
                with closing(Lift(problem, created_in(middle), options.update)) as other:
                    return other.differences(goals, estimate, options.matters)[0]

            factor = saturation(lifted, lifted.split(lifted.x)[0])
            of_mesh, factor = with_missed(problem, element, factor, values, in_middle)
            estimate.saturation = factor
            parts = {"mesh": (of_mesh, MISSED * np.abs(of_mesh))}
            if of_penalties:
                parts["penalty"] = of_penalties
            parts["algebra"] = np.zeros(len(values)), factor * unsettled
            set_parts(estimate, goals, parts)
            _set_least(lift, goals, estimate)
            differences = dict(zip(names_of(goals), values, strict=True))
            for name, in_cells in cell_indicators(lift, goals, _located(estimate, options)).items():
                # They sum to the difference; the error may be another multiple of it.
                error, difference = estimate.goals[name].of_mesh, differences[name]
                ratio = error / difference if error * difference > 0 else factor
                estimate.indicators[name] = ratio * in_cells
                if where := place(problem, estimate.indicators[name], options.mesh):
                    estimate.places[name] = where
            estimate.newton += lift.newton
            estimate.linear += lift.linear
    return estimate


def with_missed(
    problem: Problem,
    lifted: Element,
    factor: float,
    differences: Array,
    in_middle: Callable[[Element], Array],
) -> tuple[Array, float]:
    """Return differences of goals with what the lifted solution misses of the errors. Collective.

    Parameters
    ----------
    problem : Problem
        The problem of the run.
    lifted : Element
        The lifted element.
    factor : float
        The factor of the lifted solution: see `saturation`.
    differences : (goals,) array
        The goals in the lifted element less those of the run.
    in_middle : callable
        Returns the same of another element; it raises BadInput if that does not fit.

    Returns
    -------
    (goals,) array, float
        The differences, and the factor; 1 where it does not apply.
    """
    middle = element_of_factor(problem, lifted)
    if middle is None or factor == 1:
        return differences, 1.0
    others = 0.0 if middle is problem.element else first_that_fits([middle], in_middle)[1]
    return differences + (factor - 1) * (differences - others), factor


def _set_least(lift: Lift, goals: Sequence[Goal], estimate: Estimate) -> None:
    """Set the least bounds: of displacements from the field, which is one vector; of stresses.

    Errors of a stress on two sides of a point cancel in its mean. The field's errors are those at
    vertices: inside of cells the lifted displacement varies on any mesh.
    """
    lifted = lift.lifted
    change = np.abs(lifted.nodal(lifted.x) - lifted.nodal(lift.start))
    corners = _dolfinx.cell_vertices(lifted.domain).shape[1]
    vertices = np.unique(_dolfinx.node_dofs(lifted.V)[:, :corners])
    of_vertices = change[vertices[vertices < len(change)]]
    largest = lifted.comm.allreduce(float(of_vertices.max(initial=0.0)), op=MPI.MAX)
    for goal in goals:
        size = largest if goal.kind == "displacement" else 0.0
        if isinstance(goal, StressGoal):
            size = goal.size_of_change(lifted, lift.start)
        least = OF_VECTOR * MISSED * estimate.saturation * size
        for name in goal.names:
            estimate.goals[name] = replace(estimate.goals[name], least=least)


def _located(estimate: Estimate, options: EstimateOptions) -> Collection[str]:
    """Return the goals whose errors are distributed to the cells: sums of them may cancel."""
    relative = {
        name: abs(goal.of_mesh) / goal.scale for name, goal in estimate.asked.items() if goal.scale
    }
    names = [name for name in relative if relative[name] > SETTLED * options.matters]
    names.sort(key=relative.__getitem__, reverse=True)
    return names if options.locate_all else names[:1]


@contextmanager
def estimating(
    problem: Problem, goals: Sequence[Goal], mesh: Mesh | None = None
) -> Iterator[Estimate]:
    """Yield the goals of a problem, to which errors are added in the ``with`` block. Collective.

    NoEstimate that is raised in it is the reason why there are none.

    Parameters
    ----------
    problem : Problem
        The problem at its solution; its state is unchanged.
    goals : sequence of Goal
        The goals.
    mesh : Mesh, optional
        The mesh of a scene.
    """
    watch = Stopwatch()
    estimate = Estimate(_without_errors(problem, goals))
    try:
        yield estimate
        faces = mesh.round_faces if mesh else None
        faces = faces or round_faces(problem.domain, problem.kinematics.revolved)
        estimate.left_out += filter(None, [faces.text])
        _add_narrow_contacts(problem, estimate)
    except NoEstimate as reason:
        estimate.reason = str(reason)
        estimate.on_no_mesh = isinstance(reason, NoEstimateOnAnyMesh)
        estimate.steps_too_long = isinstance(reason, StepsTooLong)
    problem.split(problem.x)
    _mark_forces_without_contact(problem, goals, estimate)
    estimate.jit = watch.jit
    estimate.seconds = watch.seconds + estimate.jit


def values_of(problem: Problem, goals: Sequence[Goal]) -> Estimate:
    """Return the goals of a problem at its solution, without errors. Collective."""
    with estimating(problem, goals) as estimate:
        pass
    return estimate


def without_bounds(why: str) -> str:
    """Return the line that estimates have no bound."""
    return f"estimates have no bound, which another mesh measures: {why}"


def announce_cost(
    problem: Problem,
    elements: Sequence[Element | None],
    estimate: Estimate,
    options: EstimateOptions,
) -> None:
    """Announce what the first of some elements costs, with the memory of all of them.

    Raises
    ------
    NoEstimate
        If they need more than is allowed or available.
    """
    used = [element for element in elements if element not in (None, problem.element)]
    estimate.element, estimate.dofs = used[0].name, num_unknowns(problem.domain, used[0])
    estimate.memory = sum(memory(problem, element) for element in used)
    options.announce(estimate)
    available, most = available_memory(problem.comm), options.max_memory
    if estimate.memory > min(available, most):
        limit = f"{most / 1e6:.3g} MB are allowed"
        if available < most:
            limit = f"{available / 1e6:.2g} MB are available"
        raise NoEstimate(
            f"{estimate.element} needs about {estimate.memory / 1e6:.2g} MB of memory, of which "
            f"{limit}"
        )


def _add_narrow_contacts(problem: Problem, estimate: Estimate) -> None:
    """Add a line on obstacles whose contact is narrower than a cell. Collective."""
    u = problem.split(problem.x)[0]
    terms = [term for term in problem.terms if isinstance(term, ObstacleContact)]
    narrow = [name for term in terms for name in term.narrow(u)]
    if narrow:
        names = in_words(f"'{name}'" for name in narrow)
        estimate.left_out.append(
            f"the contact with {names} is narrower than a cell: finer ones may find another one"
        )


def _without_errors(problem: Problem, goals: Sequence[Goal]) -> dict[str, GoalError]:
    """Return the goals of a problem at its solution by name. Collective."""
    errors, at_rest = dict[str, GoalError](), is_at_rest(problem)
    for goal in goals:
        values, unit = dict(zip(goal.names, goal.bind(problem)(), strict=True)), goal.unit(problem)
        scale = max(*(abs(values[name]) for name in goal.asked), _LEAST_SCALE * unit)
        if at_rest and (unit > 0 or goal.kind == "energy"):
            scale = inf  # a multiple of rounding has no relative error
        for name, value in values.items():
            errors[name] = GoalError(value, None, scale, asked=name in goal.asked)
    return errors


def _mark_forces_without_contact(
    problem: Problem, goals: Sequence[Goal], estimate: Estimate
) -> None:
    """Remove the errors of forces of contact where neither solution touches. Collective."""
    for goal in goals:
        if not isinstance(goal, TermGoal) or goal.names[0] in estimate.loads:
            continue
        errors = {name: estimate.goals[name] for name in goal.names}
        if all(error.is_zero for error in errors.values()) and goal.is_without_contact(problem):
            for name, known in errors.items():
                unknown = replace(known, estimate=None, parts={}, missed={}, least=0.0)
                estimate.goals[name] = replace(unknown, reason=NO_CONTACT)


def set_parts(
    estimate: Estimate, goals: Sequence[Goal], parts: Mapping[str, tuple[Array, Array]]
) -> None:
    """Set the estimates of goals: the sums of their parts.

    Parameters
    ----------
    estimate : Estimate
        The estimate, which has the goals' values.
    goals : sequence of Goal
        The goals.
    parts : mapping of two arrays
        The parts (goals,) by their source, and what each may miss.
    """
    for i, name in enumerate(names_of(goals)):
        known = {source: float(part[i]) for source, (part, _) in parts.items() if part[i]}
        missed = {source: float(bound[i]) for source, (_, bound) in parts.items() if bound[i]}
        estimate.goals[name] = replace(
            estimate.goals[name], estimate=sum(known.values()), parts=known, missed=missed
        )
