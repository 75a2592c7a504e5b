"""Estimate the errors of goals: their values in the lifted problem less those of the run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.budget import (
    algebra_errors,
    penalty_errors,
    unsettled_penalties,
    yield_much,
)
from fem_snh.accuracy.cross_points import check_cross_points
from fem_snh.accuracy.differences import (
    ROUNDING,
    Differences,
    LiftedGoals,
    cell_squares,
    saturation,
    scales_of,
    values_of,
)
from fem_snh.accuracy.frequency_goals import FrequencyGoal, LiftedModes, lifted_modes
from fem_snh.accuracy.goal_bounds import add_what_is_missed
from fem_snh.accuracy.goal_errors import (
    BEGINS,
    NO_CONTACT,
    SMALL_FORCE,
    Estimate,
    GoalError,
    NoEstimate,
    NoEstimateOnAnyMesh,
    StepsTooLong,
    TooLittleMemory,
    check_problem,
)
from fem_snh.accuracy.goals import EnergyGoal, Goal, PointGoal, TermGoal, VectorGoal, names_of
from fem_snh.accuracy.indicators import cell_indicators, place
from fem_snh.accuracy.lift import (
    Lift,
    check_memory,
    create_in,
    create_lifted,
    element_of_factor,
    lifted_dofs,
    lifted_elements,
    memory,
)
from fem_snh.accuracy.shape_surfaces import (
    ShapeSurfaces,
    changes_by_surfaces,
    check_shapes,
    is_on_flesh,
)
from fem_snh.accuracy.state_checks import is_at_rest, may_lock
from fem_snh.assembly.elements import Element
from fem_snh.cache import Stopwatch
from fem_snh.contact.obstacle_contact import ObstacleContact
from fem_snh.errors import in_words
from fem_snh.mesh.mesh import Mesh
from fem_snh.mesh.round_faces import round_faces
from fem_snh.problem.problem import Problem
from fem_snh.solver import StepOutcome

Array = npt.NDArray[np.float64]
#: Parts of the errors of goals by their source, (goals,) arrays.
Parts = dict[str, Array]

#: Goals are relative to the largest component of the same vector, or to this part of the largest
#: displacement or force, if that is more.
_LEAST_SCALE = 1e-3
#: What Newton's method left is a part of the errors from this part of one of them on.
_LEAST_PART = 0.01
#: Errors below this part of the goal are not located, as their indicators are sums that cancel; nor
#: those below this part of what is asked for.
_LOCATED, _LOCATED_OF_ASKED = 1e-4, 0.25

#: Chooses, of the goals whose errors can be distributed to the cells, those whose are: each costs a
#: linear solve. Collective.
Choose = Callable[[Estimate, Sequence[str]], Collection[str]]


def every_goal(estimate: Estimate, names: Sequence[str]) -> Collection[str]:
    """Choose all goals."""
    return names


def largest_error(estimate: Estimate, names: Sequence[str]) -> Collection[str]:
    """Choose the goal with the largest relative error."""
    goals = estimate.goals
    return [max(names, key=lambda name: abs(goals[name].error or 0.0) / goals[name].scale)]


@dataclass(frozen=True)
class EstimateOptions:
    """What an estimate is for.

    Attributes
    ----------
    asked : float
        The relative error that is asked for: a small part of it may remain unsettled; 0: none is.
    stability : bool
        Whether the stability of the lifted equilibrium is examined whatever it costs.
    choose : Choose
        The goals whose errors are distributed to the cells.
    max_memory : float
        The memory that the lifted problem may have [bytes].
    """

    asked: float = 0.0
    stability: bool = False
    choose: Choose = every_goal
    max_memory: float = inf


def estimate_error(
    problem: Problem,
    make: Callable[[Element], Problem],
    goals: Sequence[Goal],
    announce: Callable[[Estimate], None] = lambda estimate: None,
    mesh: Mesh | None = None,
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
    announce : callable, optional
        Called before the lifted problem is created, with its unknowns and memory.
    mesh : Mesh, optional
        The mesh, whose groups describe where the error is.
    options : EstimateOptions, optional
        What the estimate is for.
    """

    def add_errors(estimate: Estimate) -> None:
        check_problem(problem)
        check_shapes(problem)
        _announce(problem, estimate, announce, options.max_memory)
        _add_errors(problem, make, goals, estimate, options)
        for name, indicators in estimate.indicators.items():
            if where := place(problem, indicators, mesh):
                estimate.places[name] = where

    return estimate_with(add_errors, problem, goals, mesh)


def estimate_with(
    add_errors: Callable[[Estimate], None],
    problem: Problem,
    goals: Sequence[Goal],
    mesh: Mesh | None = None,
) -> Estimate:
    """Return the goals of a problem with their errors, or why there are none. Collective.

    Parameters
    ----------
    add_errors : callable
        Adds the errors to the goals of an estimate, or raises NoEstimate.
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
        check_cross_points(problem)
        add_errors(estimate)
        if not estimate.coarser:  # which have other faces
            faces = mesh.round_faces if mesh else None
            faces = faces or round_faces(problem.domain, problem.kinematics.revolved)
            estimate.left_out += filter(None, [faces.text])
            estimate.of_curved = faces.added + faces.removed if faces.degree == 2 else 0.0
        _add_narrow_contacts(problem, estimate)
        add_what_is_missed(estimate, problem.element.degree, problem.kinematics.dim)
    except NoEstimate as reason:
        estimate.reason = str(reason)
        estimate.on_no_mesh = isinstance(reason, NoEstimateOnAnyMesh)
        estimate.steps_too_long = isinstance(reason, StepsTooLong)
        estimate.lacks_memory = isinstance(reason, TooLittleMemory)
    problem.split(problem.x)
    terms = [goal for goal in goals if isinstance(goal, TermGoal)]
    _mark_forces_without_contact(problem, terms, estimate)
    estimate.jit = watch.jit
    estimate.seconds = watch.seconds + estimate.jit
    return estimate


def _add_narrow_contacts(problem: Problem, estimate: Estimate) -> None:
    """Add the obstacles whose contact is narrower than a cell, and a line. Collective."""
    u = problem.split(problem.x)[0]
    terms = [term for term in problem.terms if isinstance(term, ObstacleContact)]
    estimate.narrow = [name for term in terms for name in term.narrow(u)]
    if estimate.narrow:
        names = in_words(f"'{name}'" for name in estimate.narrow)
        estimate.left_out.append(
            f"the contact with {names} is narrower than a cell: finer ones may find another one"
        )


def _without_errors(problem: Problem, goals: Sequence[Goal]) -> dict[str, GoalError]:
    """Return the goals of a problem at its solution by name. Collective."""
    errors: dict[str, GoalError] = {}
    vectors, at_rest = [goal.bind(problem)() for goal in goals], is_at_rest(problem)
    for goal, vector in zip(goals, vectors, strict=True):
        unit = goal.unit(problem)
        scale = max(*map(abs, vector), _LEAST_SCALE * unit)
        vanishes = unit > 0 and not isinstance(goal, FrequencyGoal)
        if at_rest and (vanishes or isinstance(goal, EnergyGoal)):
            scale = inf  # a multiple of rounding has no relative error
        pairs = zip(goal.names, vector, strict=True)
        errors |= {name: GoalError(value, None, scale) for name, value in pairs}
    return errors


def _mark_forces_without_contact(
    problem: Problem, goals: Sequence[TermGoal], estimate: Estimate
) -> None:
    """Remove the errors of forces of contact where neither solution touches. Collective."""
    for goal in goals:
        errors = {name: estimate.goals[name] for name in goal.names}
        if all(error.is_zero for error in errors.values()) and goal.is_without_contact(problem):
            for name, known in errors.items():
                estimate.goals[name] = GoalError(known.value, None, known.scale, reason=NO_CONTACT)


def mark_small_forces(goals: Sequence[Goal], estimate: Estimate) -> None:
    """Give a reason to forces of contact that are small beside others, and beside their errors."""
    forces = [goal for goal in goals if isinstance(goal, VectorGoal | TermGoal) and goal.is_force]
    sizes = [abs(estimate.goals[name].value) for name in names_of(forces)]
    for goal in forces:
        errors = [estimate.goals[name] for name in goal.names]
        if not isinstance(goal, TermGoal) or None in (e.error for e in errors):
            continue
        size = hypot(*(e.error or 0.0 for e in errors))
        corrected = hypot(*(e.corrected or 0.0 for e in errors))
        if size > hypot(*(e.value for e in errors)) and corrected < SMALL_FORCE * max(sizes):
            for name, error in zip(goal.names, errors, strict=True):
                estimate.goals[name] = replace(error, reason=BEGINS)


def _announce(
    problem: Problem, estimate: Estimate, announce: Callable[[Estimate], None], max_memory: float
) -> None:
    """Announce what the best lifted element costs; raise TooLittleMemory if it is too much."""
    element = next(lifted_elements(problem))
    estimate.element, estimate.dofs = element.name, lifted_dofs(problem, element)
    middle = element_of_factor(problem, element)
    estimate.memory = memory(problem, element) + (memory(problem, middle) if middle else 0.0)
    announce(estimate)
    check_memory(problem, element.name, estimate.memory, max_memory)


def _add_errors(
    problem: Problem,
    make: Callable[[Element], Problem],
    goals: Sequence[Goal],
    estimate: Estimate,
    options: EstimateOptions,
) -> None:
    """Add the errors to an estimate; raise NoEstimate if there are none."""
    lifted = create_lifted(problem, make)
    estimate.element = lifted.element.name
    surfaces = ShapeSurfaces(lifted)
    if surfaces:
        goals = [goal for goal in goals if is_on_flesh(goal)]
    static = [goal for goal in goals if not isinstance(goal, FrequencyGoal)]
    frequencies = [goal for goal in goals if isinstance(goal, FrequencyGoal)]
    parts, parts_of_frequencies = _other_parts(problem, static, frequencies, estimate)
    lift = Lift(problem, lifted)
    try:
        lifted_goals = LiftedGoals(lift, static, estimate, surfaces.bind)
        differences = lifted_goals.differences(options.asked)
        estimate.may_be_unstable = lift.check_stability(options.stability)
        errors = mesh = _without_algebra(differences, parts)
        if surfaces:  # they have none of the corners of cells, where the lifted solution has errors
            moved = changes_by_surfaces(surfaces, lifted_goals, errors)
            parts["shape"], mesh = moved.values, replace(errors, unsettled=moved.unsettled)
        else:
            mesh += _missed_by_lifted(lifted_goals, make, differences, errors, options.asked)
        changes: Array | None = None
        if (penalties := parts.get("penalty")) is not None:
            further = unsettled_penalties(problem, static, lifted_goals.values, penalties)
            scales = _with_least_of_forces(static, lifted_goals.scales)
            if not surfaces and yield_much(penalties, scales, options.asked):
                parts["penalty"] = _lifted_penalties(lift, lifted_goals, scales)
                changes = np.abs(parts["penalty"] - penalties)
            mesh = replace(mesh, unsettled=mesh.unsettled + further)
        _set_errors(estimate, static, mesh, parts, changes)
        _add_largest(lift, static, estimate, options.asked)
        mark_small_forces(static, estimate)  # those that do not count are not located
        modes = None
        if frequencies:
            modes = _add_frequencies(lift, frequencies, estimate, parts_of_frequencies)
        if chosen := _located(estimate, options):
            estimate.indicators = _mesh_indicators(lifted_goals, errors, mesh, chosen)
            if modes:
                estimate.indicators |= _frequency_indicators(
                    lifted, modes, frequencies, estimate, chosen
                )
        estimate.linear = lift.linear
    finally:
        lift.destroy()


def _other_parts(
    problem: Problem,
    static: Sequence[Goal],
    frequencies: Sequence[FrequencyGoal],
    estimate: Estimate,
) -> tuple[Parts, Parts]:
    """Return the parts of the errors that are not of the mesh, of static goals and frequencies.

    Frequencies have no part of what Newton's method left: it would cost the modes of its state.
    """
    outcome, parts = StepOutcome(), Parts()
    values, scales = values_of(estimate, static), scales_of(estimate, static)
    if (algebra := algebra_errors(problem, static, values)) is not None:
        relative = np.abs(algebra[scales > 0]) / scales[scales > 0]
        estimate.algebra = float(relative.max(initial=0.0))
        values = values + algebra
        parts["algebra"] = np.where(np.abs(algebra) <= ROUNDING * scales, 0.0, algebra)
    goals = [*static, *frequencies]
    values = np.append(values, values_of(estimate, frequencies))
    penalties = penalty_errors(problem, goals, values, scales_of(estimate, goals), outcome)
    estimate.penalty_newton = outcome.newton
    if penalties is None:
        return parts, {}
    of_static, of_frequencies = np.split(penalties, [len(scales)])
    return parts | {"penalty": of_static}, {"penalty": of_frequencies}


def _with_least_of_forces(goals: Sequence[Goal], scales: Array) -> Array:
    """Return what errors are relative to, of forces at least a part of the largest one."""
    of_forces = [getattr(goal, "is_force", False) for goal in goals for _ in goal.names]
    forces = scales[of_forces]
    return np.where(of_forces, np.maximum(scales, SMALL_FORCE * forces.max(initial=0.0)), scales)


def _lifted_penalties(lift: Lift, goals: LiftedGoals, scales: Array) -> Array:
    """Return what goals would change by without penalties, in the lifted problem. Collective.

    Contact that yields much, on few facets, has another part without a penalty there.
    """
    outcome = StepOutcome()
    found = penalty_errors(lift.lifted, goals.goals, goals.evaluate(), scales, outcome)
    lift.forget_hessian()
    goals.estimate.penalty_newton += outcome.newton
    assert found is not None  # the run's problem has penalties
    return found


def _without_algebra(differences: Differences, parts: Parts) -> Differences:
    """Return the differences to the run less what Newton's method left, which they contain.

    Where that is negligible beside them, the part ``algebra`` becomes zero.
    """
    if "algebra" not in parts:
        return differences
    values, algebra = differences.values, parts["algebra"]
    parts["algebra"] = np.where(np.abs(algebra) <= _LEAST_PART * np.abs(values), 0.0, algebra)
    return Differences(values - parts["algebra"], differences.unsettled)


def _missed_by_lifted(
    goals: LiftedGoals,
    make: Callable[[Element], Problem],
    differences: Differences,
    errors: Differences,
    asked: float,
) -> Differences:
    """Return what the lifted solution misses of the errors, from the decay of its own degrees.

    Parameters
    ----------
    goals : LiftedGoals
        The goals at the lifted solution.
    make : callable
        Returns the same problem on the same mesh with another element.
    differences, errors : Differences
        The goals in the lifted problem less those of the run, with and without what Newton's
        method left.
    asked : float
        The relative error that is asked for.
    """
    problem, lifted = goals.lift.problem, goals.lift.lifted
    middle = element_of_factor(problem, lifted.element)
    if middle is None and locks(problem, lifted.element):
        return Differences(*np.zeros((2, len(goals.values))))
    goals.estimate.saturation = saturation(lifted, lifted.split(lifted.x)[0])
    factor = goals.estimate.saturation - 1
    if middle is None:
        return errors.scaled(factor)
    in_middle = _differences_of(create_in(middle, problem, make), goals, asked)
    between = differences.values - in_middle.values
    return Differences(between, errors.unsettled + in_middle.unsettled).scaled(factor)


def locks(problem: Problem, lifted: Element) -> bool:
    """Return whether the run's element locks: no decay of the lifted one's degrees shows that.

    P2 on triangles hardly does, nor does an element whose lifted one is of the same kind.
    """
    triangles = problem.element.name == "P2" and problem.kinematics.dim == 2
    same = lifted.volume == problem.element.volume
    return bool(may_lock(problem)) and not triangles and not same


def _differences_of(other: Problem, goals: LiftedGoals, asked: float) -> Differences:
    """Return the goals in another element less those of the run."""
    lift = Lift(goals.lift.problem, other)
    try:
        # A copy of the estimate: the iterations that it counts are those of the lifted problem.
        return LiftedGoals(lift, goals.goals, replace(goals.estimate)).differences(asked)
    finally:
        lift.destroy()


def _set_errors(
    estimate: Estimate,
    goals: Sequence[Goal],
    mesh: Differences,
    others: Parts,
    penalty_changes: Array | None = None,
) -> None:
    """Set the errors of some goals: the sums of their parts."""
    for i, name in enumerate(names_of(goals)):
        parts = {"mesh": float(mesh.values[i])}
        parts |= {source: float(part[i]) for source, part in others.items() if part[i]}
        estimate.goals[name] = replace(
            estimate.goals[name],
            error=sum(parts.values()),
            unsettled=float(mesh.unsettled[i]),
            parts=parts if len(parts) > 1 else {},
            penalty_change=0.0 if penalty_changes is None else float(penalty_changes[i]),
        )


def _add_largest(lift: Lift, goals: Sequence[Goal], estimate: Estimate, asked: float) -> None:
    """Add the largest error of a displacement in the body to those of points. Collective.

    With a request for an accuracy ``asked`` also the mean of the size of the error to the stress
    around a point. With one pressure per cell the lifted displacement varies inside of cells, on
    any mesh: then it is no measure of those of points.
    """
    unknowns = lift.lifted.owned_displacements
    changes = lift.lifted.x.array_r[:unknowns] - lift.start.array_r[:unknowns]
    on_rank = float(np.abs(changes).max(initial=0.0))
    largest = estimate.saturation * lift.lifted.comm.allreduce(on_rank, op=MPI.MAX)
    for goal in goals:
        for name in goal.names:
            known = estimate.goals[name]
            if isinstance(goal, PointGoal) and lift.lifted.element.volume != "mean":
                estimate.goals[name] = replace(known, of_body=largest)
            elif asked and (size_of_change := getattr(goal, "size_of_change", None)):
                size = estimate.saturation * size_of_change(lift.lifted, lift.start)
                estimate.goals[name] = replace(known, of_size=size)


def _add_frequencies(
    lift: Lift, goals: Sequence[FrequencyGoal], estimate: Estimate, others: Parts
) -> LiftedModes | None:
    """Add the errors of frequencies. Collective.

    Returns
    -------
    LiftedModes or None
        The lifted modes; None if they were not found, and no errors were added.
    """
    modes = lifted_modes(lift, goals[0].modes)
    if modes is None:
        return None
    numbers = [goal.number - 1 for goal in goals]
    shapes = [] if locks(lift.problem, lift.lifted.element) else [modes.shapes[i] for i in numbers]
    # The root: smooth modes leave nothing, those of clamped bodies the factor.
    factors = np.sqrt([saturation(lift.lifted, shape) for shape in shapes]) if shapes else 1.0
    changes = modes.frequencies[numbers] - values_of(estimate, goals)
    errors = Differences(changes, modes.unsettled[numbers]).scaled(factors)
    _set_errors(estimate, goals, errors, others)
    return modes


def _located(estimate: Estimate, options: EstimateOptions) -> Collection[str]:
    """Return the goals whose errors are distributed to the cells. Collective."""
    least = _LOCATED
    if options.asked:
        least = min(least, _LOCATED_OF_ASKED * options.asked)
    names = [
        name
        for name, goal in estimate.goals.items()
        if goal.is_found and abs(goal.error or 0.0) > least * goal.scale
    ]
    return options.choose(estimate, names) if names else ()


def _mesh_indicators(
    goals: LiftedGoals, errors: Differences, mesh: Differences, chosen: Collection[str]
) -> dict[str, Array]:
    """Return the errors of chosen goals in cells, with the part that the lifted solution misses.

    Parameters
    ----------
    goals : LiftedGoals
        The goals at the lifted solution.
    errors, mesh : Differences
        The errors without and with that part.
    chosen : collection of str
        The names of the goals.
    """
    ratios = np.full(len(errors.values), goals.estimate.saturation)
    np.divide(mesh.values, errors.values, out=ratios, where=mesh.values * errors.values > 0)
    factors = dict(zip(names_of(goals.goals), ratios, strict=True))
    cells = cell_indicators(goals.lift, goals.goals, chosen.__contains__)
    return {name: factors[name] * values for name, values in cells.items()}


def _frequency_indicators(
    lifted: Problem,
    modes: LiftedModes,
    goals: Sequence[FrequencyGoal],
    estimate: Estimate,
    chosen: Collection[str],
) -> dict[str, Array]:
    """Return the errors of chosen frequencies in cells, as the squares of the modes' changes."""
    indicators = {}
    for name, goal in zip(names_of(goals), goals, strict=True):
        if name in chosen:
            squares = cell_squares(lifted, modes.changes[goal.number - 1])
            total = lifted.comm.allreduce(squares.sum())
            indicators[name] = squares * ((estimate.goals[name].error or 0.0) / total)
    return indicators
