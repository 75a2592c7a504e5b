"""Estimate the errors of goals: their values in the lifted problem less those of the run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from math import hypot, inf
from time import perf_counter

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.budget import algebra_errors, penalty_errors
from fem_snh.accuracy.frequency_goals import FrequencyGoal, LiftedModes, lifted_modes
from fem_snh.accuracy.goal_errors import (
    BEGINS,
    NO_CONTACT,
    SMALL_FORCE,
    UNSETTLED,
    Estimate,
    GoalError,
)
from fem_snh.accuracy.goals import (
    EnergyGoal,
    Goal,
    PointGoal,
    TermGoal,
    VolumeGoal,
    largest_displacement,
    names_of,
    vector_of,
)
from fem_snh.accuracy.indicators import cell_indicators, place
from fem_snh.accuracy.lift import (
    Lift,
    NoEstimate,
    NoEstimateOnAnyMesh,
    check_memory,
    check_problem,
    create_in,
    create_lifted,
    lifted_dofs,
    lifted_elements,
    memory,
    taylor_hood,
)
from fem_snh.accuracy.pressure_oscillation import may_lock
from fem_snh.accuracy.saturation import cell_squares, saturation
from fem_snh.accuracy.shape_surfaces import ShapeSurfaces, check_shapes, is_on_flesh
from fem_snh.assembly.elements import Element
from fem_snh.mesh.mesh import Mesh
from fem_snh.mesh.round_faces import round_faces
from fem_snh.problem.problem import Problem
from fem_snh.solver import StepOutcome

Array = npt.NDArray[np.float64]

#: An estimate is found when further Newton iterations would change it by less than this part of it;
#: relative to the goal also by less than this part of the largest error of a goal, up to this bound
#: of changes that are negligible, and down to what is rounding.
_SETTLED, _OF_LARGEST, _NEGLIGIBLE, _ROUNDING = 0.02, 0.01, 1e-4, 1e-6
#: Part of the relative error that is asked for which may be unsettled.
_OF_ASKED = 0.05
#: They would change it by this multiple of the last change, times what the last iteration left of
#: the residual (docs/results/error.md), and at least by this part of the last change.
_CONTRACTION, _LEAST_CHANGE = 3.0, 0.03
#: The least Newton iterations, as the first change is the whole estimate; and the part of the first
#: residual to which the residual is reduced at least.
_LEAST_NEWTON, _REDUCED = 2, 1e-2
#: Goals are relative to the largest component of the same vector, or to this part of the largest
#: displacement or force, if that is more.
_LEAST_SCALE = 1e-3
#: Displacements below this part of the body's length are rounding where the forces are, too.
_AT_REST = 1e-12
#: There is no estimate if more than this part of the forces is rounding: with 1 % errors of 2 % are
#: a quarter too small (a cube stretched by 1e-11).
_LARGEST_ROUNDING = 0.01
#: What Newton's method left is a part of the errors from this part of one of them on.
_LEAST_PART = 0.01
#: Moves of the nodes below the surfaces of shapes at most, each followed by a Newton iteration. A
#: move leaves at most half of what is missing.
_MOST_MOVES = 8
#: Part of what penalties change that is unsettled where surfaces of the body touch each other: the
#: pairs change, and stiffer penalties may find another state. Measured with self-contact; a term
#: with ``unsettled_penalty`` has its own.
_OF_PAIRS = 0.35
#: Where surfaces of the body touch each other, components beside the largest one of a vector are
#: unsettled by this multiple of what penalties change of them, or by this part of the most that
#: they change in the vector, if that is less. With 100 times the stiffness such components of the
#: force between two bodies change by another amount than was found, by up to 1.6 times that and
#: 0.29 of the most.
_BESIDE, _OF_MOST = 2.0, 0.35
#: Part of the largest error of a vector that remains uncertain of each component with such shapes.
_OF_VECTOR = 0.05
#: Errors below this part of the goal are not located, as their indicators are sums that cancel; nor
#: those below this part of what is asked for.
_LOCATED, _LOCATED_OF_ASKED = 1e-4, 0.25


def estimated(
    problem: Problem,
    goals: Sequence[Goal],
    find: Callable[[Estimate], None],
    mesh: Mesh | None = None,
) -> Estimate:
    """Return the goals of a problem with their errors, or why there are none. Collective.

    Parameters
    ----------
    problem : Problem
        The problem at its solution; its state is unchanged.
    goals : sequence of Goal
        The goals.
    find : callable
        Adds the errors to the goals, or raises NoEstimate.
    mesh : Mesh, optional
        The mesh of a scene.
    """
    start, found = perf_counter(), Estimate(_without_errors(problem, goals))
    try:
        find(found)
        faces = mesh.round_faces if mesh else None
        faces = faces or round_faces(problem.domain, problem.kinematics.revolved)
        found.left_out += filter(None, [faces.text])
    except NoEstimate as reason:
        found.reason = str(reason)
        found.on_no_mesh = isinstance(reason, NoEstimateOnAnyMesh)
    problem.split(problem.x)
    for goal in goals:
        zero = all(found.goals[name].is_zero for name in goal.names)
        if zero and isinstance(goal, TermGoal) and goal.is_without_contact(problem):
            for name in goal.names:
                known = found.goals[name]
                found.goals[name] = GoalError(known.value, None, known.scale, reason=NO_CONTACT)
    _mark_small_contacts(found, goals)
    found.seconds = perf_counter() - start
    return found


def _mark_small_contacts(found: Estimate, goals: Sequence[Goal]) -> None:
    """Give a reason to forces of contact that are small beside others, and beside their errors."""
    forces = [abs(g.value) for name, g in found.goals.items() if vector_of(name).endswith(".force")]
    for goal in goals:
        errors = [found.goals[name] for name in goal.names]
        if not (isinstance(goal, TermGoal) and goal.is_force) or None in (e.error for e in errors):
            continue
        size = hypot(*(e.error or 0.0 for e in errors))
        corrected = hypot(*(e.corrected or 0.0 for e in errors))
        if size > hypot(*(e.value for e in errors)) and corrected < SMALL_FORCE * max(forces):
            for name, error in zip(goal.names, errors, strict=True):
                found.goals[name] = replace(error, reason=BEGINS)


def _without_errors(problem: Problem, goals: Sequence[Goal]) -> dict[str, GoalError]:
    """Return the goals of a problem at its solution by name. Collective."""
    found: dict[str, GoalError] = {}
    vectors, at_rest = [goal.bind(problem)() for goal in goals], _is_at_rest(problem)
    for goal, vector in zip(goals, vectors, strict=True):
        unit = goal.unit(problem)
        scale = max(*map(abs, vector), _LEAST_SCALE * unit)
        vanishes = unit > 0 and not isinstance(goal, FrequencyGoal)
        if at_rest and (vanishes or isinstance(goal, EnergyGoal)):
            scale = inf  # a multiple of rounding has no relative error
        pairs = zip(goal.names, vector, strict=True)
        found |= {name: GoalError(value, None, scale) for name, value in pairs}
    return found


def _is_at_rest(problem: Problem) -> bool:
    """Return whether displacements and forces are zero to rounding. Collective."""
    moved = largest_displacement(problem) > _AT_REST * problem.length
    return not moved and problem.largest_force(problem.x) <= problem.rounding_force


#: Chooses, of the goals whose errors can be distributed to the cells, those whose are: each costs a
#: linear solve. Collective.
Choose = Callable[[Estimate, Sequence[str]], Collection[str]]


def every_goal(found: Estimate, names: Sequence[str]) -> Collection[str]:
    """Choose all goals."""
    return names


def largest_error(found: Estimate, names: Sequence[str]) -> Collection[str]:
    """Choose the goal with the largest relative error."""
    return [max(names, key=lambda n: abs(found.goals[n].error or 0.0) / found.goals[n].scale)]


def estimate_error(
    problem: Problem,
    make: Callable[[Element], Problem],
    goals: Sequence[Goal],
    announce: Callable[[Estimate], None] = lambda estimate: None,
    mesh: Mesh | None = None,
    choose: Choose = every_goal,
    stability: bool = False,
    asked: float = 0.0,
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
    choose : Choose
        The goals whose errors are distributed to the cells.
    stability : bool
        Whether the stability of the lifted equilibrium is examined whatever it costs.
    asked : float
        The relative error that is asked for: a small part of it may remain unsettled.
    """

    def find(found: Estimate) -> None:
        _find_errors(problem, make, goals, found, announce, choose, stability, asked)
        for name, indicators in found.indicators.items():
            if where := place(problem, indicators, mesh):
                found.places[name] = where

    return estimated(problem, goals, find, mesh)


def _find_errors(
    problem: Problem,
    make: Callable[[Element], Problem],
    goals: Sequence[Goal],
    found: Estimate,
    announce: Callable[[Estimate], None],
    choose: Choose,
    stability: bool,
    asked: float,
) -> None:
    """Add the estimates; raise NoEstimate if there is none."""
    check_problem(problem)
    check_shapes(problem)
    _announce(problem, found, announce)
    lifted = create_lifted(problem, make)
    found.element, found.jit = lifted.element.name, lifted.seconds["jit"]
    surfaces = ShapeSurfaces(lifted)
    if surfaces:
        goals = [goal for goal in goals if is_on_flesh(goal)]
    static = [goal for goal in goals if not isinstance(goal, FrequencyGoal)]
    frequencies = [goal for goal in goals if isinstance(goal, FrequencyGoal)]
    others = _other_parts(problem, static, frequencies, found)
    lift = Lift(problem, lifted)
    try:
        functions = [surfaces.bind(goal) for goal in static]
        difference, unsettled = _differences(lift, functions, static, found, asked)
        found.may_be_unstable = lift.check_stability(stability)
        errors = _less_algebra(difference, others)
        mesh = errors
        if surfaces:  # they have none of the corners of cells, where the lifted solution has errors
            others["shape"], unsettled = _changes_by_shapes(
                lift, surfaces, functions, static, errors, unsettled, found
            )
        else:
            rest, further = _errors_of_lifted(
                lift, make, static, found, asked, difference, errors, unsettled
            )
            mesh, unsettled = errors + rest, unsettled + further
        if "penalty" in others and problem.coupling_terms:
            unsettled = unsettled + _unsettled_penalties(problem, static, found, others["penalty"])
        _add(found, static, mesh, others, unsettled)
        _add_largest(lift, static, found)
        modes = _add_frequencies(lift, frequencies, found, others) if frequencies else None
        if chosen := _located(found, choose, asked):
            ratios = np.full(len(errors), found.saturation)
            np.divide(mesh, errors, out=ratios, where=mesh * errors > 0)
            of_goals = dict(zip(names_of(static), ratios, strict=True))
            cells = cell_indicators(lift, static, chosen.__contains__)
            found.indicators = {name: of_goals[name] * values for name, values in cells.items()}
            if modes:
                found.indicators |= _frequency_indicators(lifted, modes, frequencies, found, chosen)
        found.linear = lift.linear
    finally:
        lift.destroy()


def _unsettled_penalties(
    problem: Problem, goals: Sequence[Goal], found: Estimate, penalties: Array
) -> Array:
    """Return what is unsettled of the penalties' part where surfaces of the body touch."""
    values, first = np.abs(_values(found, goals)[0]), 0
    changes = np.abs(penalties[: len(values)])
    parts = [getattr(term, "unsettled_penalty", _OF_PAIRS) for term in problem.coupling_terms]
    unsettled = max(parts) * changes
    for goal in goals:
        own = slice(first, first + len(goal.names))
        beside = np.minimum(_BESIDE * changes[own], _OF_MOST * changes[own].max())
        smaller = values[own] < values[own].max()
        unsettled[own] = np.where(smaller, np.maximum(unsettled[own], beside), unsettled[own])
        first = own.stop
    return np.asarray(unsettled)


def _announce(problem: Problem, found: Estimate, announce: Callable[[Estimate], None]) -> None:
    """Announce what the best lifted element costs; raise NoEstimate if there is no memory."""
    element = next(lifted_elements(problem))
    found.element, found.dofs = element.name, lifted_dofs(problem, element)
    middle = taylor_hood(problem, element)
    found.memory = memory(problem, element) + (memory(problem, middle) if middle else 0.0)
    announce(found)
    check_memory(problem, found.memory)


def _less_algebra(difference: Array, others: dict[str, Array]) -> Array:
    """Return the difference to the run less what Newton's method left, which it contains.

    Where that is negligible beside it, the part ``algebra`` becomes zero.
    """
    if "algebra" not in others:
        return difference
    algebra = others["algebra"][: len(difference)]
    algebra[np.abs(algebra) <= _LEAST_PART * np.abs(difference)] = 0.0
    return difference - algebra


def _locks(problem: Problem) -> bool:
    """Return whether the run's element locks: no decay of the lifted one's degrees shows that.

    P2 on triangles hardly does.
    """
    triangles = problem.element.name == "P2" and problem.kinematics.dim == 2
    return bool(may_lock(problem)) and not triangles


def _errors_of_lifted(
    lift: Lift,
    make: Callable[[Element], Problem],
    goals: Sequence[Goal],
    found: Estimate,
    asked: float,
    difference: Array,
    errors: Array,
    unsettled: Array,
) -> tuple[Array, Array]:
    """Return the errors of the lifted solution, and what is unsettled of them.

    Parameters
    ----------
    difference, errors : (goals,) array
        The goals in the lifted problem less those of the run, with and without algebra.
    unsettled : (goals,) array
        What is unsettled of them.
    """
    problem, lifted = lift.problem, lift.lifted
    middle = taylor_hood(problem, lifted.element)
    if middle is None and _locks(problem):
        return np.zeros_like(errors), np.zeros_like(errors)
    found.saturation = saturation(lifted, lifted.split(lifted.x)[0])
    if middle:
        in_middle, further = _in_middle(
            problem, create_in(middle, problem, make), goals, found, asked
        )
        errors, unsettled = difference - in_middle, unsettled + further
    return (found.saturation - 1) * errors, (found.saturation - 1) * unsettled


def _located(found: Estimate, choose: Choose, asked: float) -> Collection[str]:
    """Return the goals whose errors are distributed to the cells. Collective."""
    least = min(_LOCATED, _LOCATED_OF_ASKED * asked) if asked else _LOCATED
    names = [
        name
        for name, goal in found.goals.items()
        if goal.is_found and abs(goal.error or 0.0) > least * goal.scale
    ]
    return choose(found, names) if names else ()


def _values(found: Estimate, goals: Sequence[Goal]) -> tuple[Array, Array]:
    """Return the values of some goals, and what their errors are compared with."""
    known = [found.goals[name] for name in names_of(goals)]
    return np.array([goal.value for goal in known]), np.array([goal.scale for goal in known])


def _add_frequencies(
    lift: Lift, goals: Sequence[FrequencyGoal], found: Estimate, others: dict[str, Array]
) -> LiftedModes | None:
    """Add the errors of frequencies, the last goals of ``others``. Collective.

    Returns
    -------
    LiftedModes or None
        The lifted modes; None if they were not found, and no errors were added.
    """
    modes = lifted_modes(lift, goals[0].modes)
    if modes is None:
        return None
    numbers = [goal.number - 1 for goal in goals]
    shapes = [] if _locks(lift.problem) else [modes.shapes[i] for i in numbers]
    # The root: smooth modes leave nothing, those of clamped bodies the factor.
    factors = np.sqrt([saturation(lift.lifted, shape) for shape in shapes]) if shapes else 1.0
    errors = factors * (modes.frequencies[numbers] - _values(found, goals)[0])
    of_modes = {source: part[-len(goals) :] for source, part in others.items()}
    _add(found, goals, errors, of_modes, factors * modes.unsettled[numbers])
    return modes


def _frequency_indicators(
    lifted: Problem,
    modes: LiftedModes,
    goals: Sequence[FrequencyGoal],
    found: Estimate,
    chosen: Collection[str],
) -> dict[str, Array]:
    """Return the errors of chosen frequencies in cells, as the squares of the modes' changes."""
    indicators = {}
    for name, goal in zip(names_of(goals), goals, strict=True):
        if name in chosen:
            squares = cell_squares(lifted, modes.changes[goal.number - 1])
            total = lifted.comm.allreduce(squares.sum())
            indicators[name] = squares * ((found.goals[name].error or 0.0) / total)
    return indicators


def _other_parts(
    problem: Problem, static: Sequence[Goal], frequencies: Sequence[Goal], found: Estimate
) -> dict[str, Array]:
    """Return the parts of the errors that are not of the mesh, and note what they cost.

    What Newton's method left of frequencies is zero here: it would cost the modes of its state.
    """
    outcome, parts = StepOutcome(), {}
    values, scales = _values(found, static)
    if (algebra := algebra_errors(problem, static, values)) is not None:
        relative = np.abs(algebra[scales > 0]) / scales[scales > 0]
        found.algebra = float(relative.max(initial=0.0))
        values = values + algebra
        algebra[np.abs(algebra) <= _ROUNDING * scales] = 0.0
        parts["algebra"] = np.append(algebra, np.zeros(len(frequencies)))
    goals = [*static, *frequencies]
    values = np.append(values, _values(found, frequencies)[0])
    scales = _values(found, goals)[1]
    if (penalties := penalty_errors(problem, goals, values, scales, outcome)) is not None:
        parts["penalty"] = penalties
    found.penalty_newton = outcome.newton
    return parts


def _add(
    found: Estimate,
    goals: Sequence[Goal],
    mesh: Array,
    others: dict[str, Array],
    unsettled: Array,
) -> None:
    """Add the parts of the errors to some goals."""
    for i, name in enumerate(names_of(goals)):
        parts = {"mesh": float(mesh[i])}
        parts |= {source: float(part[i]) for source, part in others.items() if part[i]}
        found.goals[name] = replace(
            found.goals[name],
            error=sum(parts.values()),
            unsettled=float(unsettled[i]),
            parts=parts if len(parts) > 1 else {},
        )


def _add_largest(lift: Lift, goals: Sequence[Goal], found: Estimate) -> None:
    """Add the largest error of a displacement in the body to those of points. Collective.

    With one pressure per cell the lifted displacement varies inside of cells, on any mesh.
    """
    if lift.lifted.element.volume == "mean":
        return
    unknowns = lift.lifted.owned_displacements
    changes = lift.lifted.x.array_r[:unknowns] - lift.start.array_r[:unknowns]
    own = float(np.abs(changes).max(initial=0.0))
    largest = found.saturation * lift.lifted.comm.allreduce(own, op=MPI.MAX)
    for name in names_of([goal for goal in goals if isinstance(goal, PointGoal)]):
        found.goals[name] = replace(found.goals[name], of_body=largest)


def _least_of_vectors(goals: Sequence[Goal], errors: Array) -> Array:
    """Return the part of the largest error in the same vector that is uncertain of each."""
    found, first = np.zeros(len(errors)), 0
    for goal in goals:
        own = slice(first, first + len(goal.names))
        found[own] = _OF_VECTOR * np.abs(errors[own]).max()
        first = own.stop
    return found


def _changes_by_shapes(
    lift: Lift,
    surfaces: ShapeSurfaces,
    functions: Sequence[Callable[[], Sequence[float]]],
    goals: Sequence[Goal],
    errors: Array,
    unsettled: Array,
    found: Estimate,
) -> tuple[Array, Array]:
    """Return what moving solids at their surfaces changes of goals, and all that is unsettled.

    Parameters
    ----------
    functions : sequence of callable
        Evaluate the goals in the lifted problem.
    errors, unsettled : (goals,) array
        The errors before, and what is unsettled of them.
    """

    def values() -> Array:
        return np.array([value for function in functions for value in function()])

    lift.allow(2 * _MOST_MOVES)
    start = last = values()
    moved: Array = np.zeros(len(start))
    for _ in range(_MOST_MOVES if surfaces.below else 0):
        surfaces.update()
        lift.solve()
        found.newton, found.linear = lift.newton, lift.linear
        before, last = last, values()
        moved = np.abs(last - before)  # the further moves are at most a geometric series
        if (moved <= _SETTLED * np.abs(errors + last - start)).all():
            break
    if not np.isfinite(last).all():
        raise NoEstimate("a goal is not finite with the surfaces of shapes")
    change = last - start
    # That of a volume is what the continuation of the flesh misses: no more than a bound.
    inexact = [isinstance(goal, VolumeGoal) for goal in goals for _ in goal.names]
    unsettled = unsettled + np.where(inexact, np.abs(change), moved)
    whole = errors + change
    unsettled = np.maximum(unsettled, _least_of_vectors(goals, whole))
    printed = unsettled > UNSETTLED * np.abs(whole)  # as a bound, of twice the size
    return change, unsettled + np.where(printed, unsettled + np.abs(whole), 0.0)


def _in_middle(
    problem: Problem, middle: Problem, goals: Sequence[Goal], found: Estimate, asked: float
) -> tuple[Array, Array]:
    """Return the differences of `_differences` to the Taylor-Hood element of the run's degree."""
    lift = Lift(problem, middle)
    try:
        functions = [goal.bind(middle) for goal in goals]
        return _differences(lift, functions, goals, replace(found), asked)
    finally:
        lift.destroy()


def _unsettled_at_end(lift: Lift, errors: Array, scales: Array) -> Array:
    """Return what the residual of the lifted problem leaves of errors. Collective.

    If the run's state is a solution in it, the errors are at most about the part that the residual
    is of the forces.

    Raises
    ------
    NoEstimate
        If forces are so small that this part is rounding.
    """
    problem = lift.problem
    forces = problem.largest_force(problem.x)
    if not forces or _is_at_rest(problem):
        return np.zeros(len(errors))
    part = lift.residual / forces
    if part > _LARGEST_ROUNDING and lift.residual <= lift.lifted.rounding_force:
        raise NoEstimate(
            f"{100 * part:.2g} % of the forces are within rounding in {lift.lifted.element.name}, "
            "as strains are so small"
        )
    if lift.newton == 0:
        return np.maximum(np.abs(errors), part * np.where(np.isfinite(scales), scales, 0.0))
    return min(_CONTRACTION * lift.reduction, 1.0) * np.abs(errors)


def _differences(
    lift: Lift,
    functions: Sequence[Callable[[], Sequence[float]]],
    goals: Sequence[Goal],
    found: Estimate,
    asked: float,
) -> tuple[Array, Array]:
    """Return the goals in the lifted problem less those of the run, and what is unsettled of them.

    The functions evaluate the goals in the lifted problem. Of a relative error that is asked for a
    small part may be unsettled.

    Raises
    ------
    NoEstimate
        If no stable equilibrium is found, or the differences do not settle.
    """
    name = lift.lifted.element.name
    values, scales = _values(found, goals)
    errors: Array = np.zeros(len(values))
    while True:
        before = errors
        lift.solve()
        found.newton, found.linear = lift.newton, lift.linear
        errors = np.array([value for function in functions for value in function()]) - values
        if not np.isfinite(errors).all():
            raise NoEstimate(f"a goal is not finite in the state of {name}")
        further = max(_LEAST_CHANGE, _CONTRACTION * lift.last_reduction)
        if lift.at_end:
            unsettled = _unsettled_at_end(lift, errors, scales)
        else:
            unsettled = further * np.abs(errors - before)
        relative = np.abs(errors[scales > 0]) / scales[scales > 0]
        of_scale = min(_OF_LARGEST * relative.max(initial=0.0), _NEGLIGIBLE)
        of_scale = max(of_scale, _OF_ASKED * asked, _ROUNDING)
        limits = np.maximum(_SETTLED * np.abs(errors), of_scale * scales)
        settled = (unsettled <= limits).all()
        enough = lift.newton >= _LEAST_NEWTON and lift.reduction <= _REDUCED
        if lift.at_end or (settled and enough and lift.stable):
            break
    if not lift.stable:
        raise NoEstimate(
            f"the equilibrium of {name} near the run's is unstable: its Hessian has negative "
            "curvature"
        )
    return errors, unsettled
