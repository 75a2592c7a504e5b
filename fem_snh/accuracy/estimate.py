"""Estimate the errors of goals: their values in the lifted problem less those of the run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import hypot, inf

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.cross_points import check_cross_points
from fem_snh.accuracy.differences import (
    Differences,
    LiftedGoals,
    penalty_errors,
    saturation,
    scales_of,
    unsettled_penalties,
    yield_much,
)
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
    check_problem,
    check_shapes,
)
from fem_snh.accuracy.goals import Goal, PointGoal, TermGoal, names_of
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
from fem_snh.accuracy.state_notes import is_at_rest, may_lock
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
#: Errors below this part of the goal are not located, as their indicators are sums that cancel; nor
#: those below this part of what is asked for.
_LOCATED, _LOCATED_OF_ASKED = 1e-4, 0.25

#: Called with the cost, before the errors are estimated.
Announce = Callable[[Estimate], None]


@dataclass(frozen=True)
class EstimateOptions:
    """What an estimate is for.

    Attributes
    ----------
    asked : float
        The relative error that is asked for: a small part of it may remain unsettled; 0: none is.
    stability : bool
        Whether the stability of the lifted equilibrium is examined whatever it costs.
    locate_all : bool
        Whether the errors of all goals are distributed to the cells, each with a linear solve; else
        the largest relative error is.
    max_memory : float
        The memory that the lifted problem may have [bytes].
    """

    asked: float = 0.0
    stability: bool = False
    locate_all: bool = True
    max_memory: float = inf


def estimate_error(
    problem: Problem,
    make: Callable[[Element], Problem],
    goals: Sequence[Goal],
    announce: Announce = lambda estimate: None,
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
    with estimating(problem, goals, mesh) as estimate:
        check_cross_points(problem)
        check_problem(problem)
        check_shapes(problem)
        element = next(lifted_elements(problem))
        elements = [element, element_of_factor(problem, element)]
        announce_cost(problem, elements, estimate, announce, options.max_memory)
        lifted = _LiftedErrors(problem, make, goals, estimate, options)
        try:
            lifted.add()
        finally:
            lifted.lift.destroy()
        for name, indicators in estimate.indicators.items():
            if where := place(problem, indicators, mesh):
                estimate.places[name] = where
    return estimate


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
        estimate.of_curved = faces.added + faces.removed if faces.degree == 2 else 0.0
        _mark_small_forces(goals, estimate)
        _add_narrow_contacts(problem, estimate)
        add_what_is_missed(estimate, problem.element.degree, problem.kinematics.dim)
    except NoEstimate as reason:
        estimate.reason = str(reason)
        estimate.on_no_mesh = isinstance(reason, NoEstimateOnAnyMesh)
        estimate.steps_too_long = isinstance(reason, StepsTooLong)
    problem.split(problem.x)
    _mark_forces_without_contact(problem, goals, estimate)
    estimate.jit = watch.jit
    estimate.seconds = watch.seconds + estimate.jit


def announce_cost(
    problem: Problem,
    elements: Sequence[Element | None],
    estimate: Estimate,
    announce: Announce,
    max_memory: float,
) -> None:
    """Announce what the first of some elements costs, with the memory of all of them.

    Raises
    ------
    NoEstimate
        If they need more than is allowed or available.
    """
    used = [element for element in elements if element]
    estimate.element, estimate.dofs = used[0].name, lifted_dofs(problem, used[0])
    estimate.memory = sum(memory(problem, element) for element in used)
    announce(estimate)
    check_memory(problem, estimate.element, estimate.memory, max_memory)


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
        if at_rest and (unit > 0 or goal.kind == "energy"):
            scale = inf  # a multiple of rounding has no relative error
        pairs = zip(goal.names, vector, strict=True)
        errors |= {name: GoalError(value, None, scale) for name, value in pairs}
    return errors


def _mark_forces_without_contact(
    problem: Problem, goals: Sequence[Goal], estimate: Estimate
) -> None:
    """Remove the errors of forces of contact where neither solution touches. Collective."""
    for goal in goals:
        if not isinstance(goal, TermGoal):
            continue
        errors = {name: estimate.goals[name] for name in goal.names}
        if all(error.is_zero for error in errors.values()) and goal.is_without_contact(problem):
            for name, known in errors.items():
                estimate.goals[name] = GoalError(known.value, None, known.scale, reason=NO_CONTACT)


def _mark_small_forces(goals: Sequence[Goal], estimate: Estimate) -> None:
    """Give a reason to forces of contact that are small beside others, and beside their errors."""
    forces = [goal for goal in goals if goal.is_force]
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


class _LiftedErrors:
    """The errors of goals: their values in the lifted problem less those of the run. Collective.

    Parameters are those of `estimate_error`, and the estimate to which they are added.

    Attributes
    ----------
    lift : Lift
        The lifted problem.
    """

    def __init__(
        self,
        problem: Problem,
        make: Callable[[Element], Problem],
        goals: Sequence[Goal],
        estimate: Estimate,
        options: EstimateOptions,
    ) -> None:
        self._problem, self._make = problem, make
        self._estimate, self._options = estimate, options
        lifted = create_lifted(problem, make)
        estimate.element = lifted.element.name
        self._given = goals
        #: The parts of the errors that are not of the mesh.
        self._parts = Parts()
        outcome = StepOutcome()
        penalties = penalty_errors(problem, goals, scales_of(estimate, goals), outcome)
        if penalties is not None:
            self._parts["penalty"] = penalties
        estimate.penalty_newton = outcome.newton
        self.lift = Lift(problem, lifted)
        self._goals = LiftedGoals(self.lift, goals, estimate)

    def add(self) -> None:
        """Add the errors to the estimate; raise NoEstimate if there are none."""
        estimate, options, goals = self._estimate, self._options, self._goals
        differences = goals.differences(options.asked)
        estimate.may_be_unstable = self.lift.check_stability(options.stability)
        mesh = differences + self._missed(differences)
        changes = np.zeros(len(goals.values))
        if (penalties := self._parts.get("penalty")) is not None:
            further = unsettled_penalties(self._problem, self._given, goals.values, penalties)
            scales = self._scales_of_penalties()
            if yield_much(penalties, scales, options.asked):
                self._parts["penalty"] = self._lifted_penalties(scales)
                changes = np.abs(self._parts["penalty"] - penalties)
            mesh = replace(mesh, unsettled=mesh.unsettled + further)
        self._set_errors(self._given, mesh, self._parts)
        for name, change in zip(names_of(self._given), changes, strict=True):
            estimate.goals[name] = replace(estimate.goals[name], penalty_change=float(change))
        self._add_largest()
        _mark_small_forces(self._given, estimate)  # those that do not count are not located
        if chosen := self._located():
            estimate.indicators = self._mesh_indicators(differences, mesh, chosen)
        estimate.linear = self.lift.linear

    def _scales_of_penalties(self) -> Array:
        """Return what errors are relative to, of forces at least a part of the largest one."""
        scales = self._goals.scales
        forces = np.array([goal.is_force for goal in self._given for _ in goal.names], bool)
        least = SMALL_FORCE * scales[forces].max(initial=0.0)
        return np.where(forces, np.maximum(scales, least), scales)

    def _lifted_penalties(self, scales: Array) -> Array:
        """Return what goals would change by without penalties, in the lifted problem.

        Contact that yields much, on few facets, has another part without a penalty there.
        """
        outcome, goals = StepOutcome(), self._goals
        found = penalty_errors(self.lift.lifted, goals.goals, scales, outcome)
        self.lift.forget_hessian()
        self._estimate.penalty_newton += outcome.newton
        assert found is not None  # the run's problem has penalties
        return found

    def _missed(self, differences: Differences) -> Differences:
        """Return what the lifted solution misses of the errors, from the decay of its own degrees.

        ``differences`` are the goals in the lifted problem less those of the run.
        """
        problem, lifted, estimate = self._problem, self.lift.lifted, self._estimate
        middle = element_of_factor(problem, lifted.element)
        if middle is None and locks(problem, lifted.element):
            return differences.scaled(0.0)
        estimate.saturation = saturation(lifted, lifted.split(lifted.x)[0])
        factor = estimate.saturation - 1
        if middle is None:
            return differences.scaled(factor)
        lift = Lift(problem, create_in(middle, problem, self._make))
        try:
            # A copy of the estimate: the iterations that it counts are those of the lifted problem.
            goals = LiftedGoals(lift, self._given, replace(estimate))
            in_middle = goals.differences(self._options.asked)
        finally:
            lift.destroy()
        between = differences.values - in_middle.values
        return Differences(between, differences.unsettled + in_middle.unsettled).scaled(factor)

    def _set_errors(self, goals: Sequence[Goal], mesh: Differences, others: Parts) -> None:
        """Set the errors of some goals: the sums of their parts."""
        for i, name in enumerate(names_of(goals)):
            parts = {"mesh": float(mesh.values[i])}
            parts |= {source: float(part[i]) for source, part in others.items() if part[i]}
            self._estimate.goals[name] = replace(
                self._estimate.goals[name],
                error=sum(parts.values()),
                unsettled=float(mesh.unsettled[i]),
                parts=parts if len(parts) > 1 else {},
            )

    def _add_largest(self) -> None:
        """Add the largest error of a displacement in the body to those of points.

        With a request for an accuracy also the mean of the size of the error to the stress around a
        point. With one pressure per cell the lifted displacement varies inside of cells, on any
        mesh: then it is no measure of those of points.
        """
        lift, goals, factor = self.lift, self._estimate.goals, self._estimate.saturation
        unknowns = lift.lifted.owned_displacements
        changes = lift.lifted.x.array_r[:unknowns] - lift.start.array_r[:unknowns]
        on_rank = float(np.abs(changes).max(initial=0.0))
        largest = factor * lift.lifted.comm.allreduce(on_rank, op=MPI.MAX)
        for goal in self._given:
            if isinstance(goal, PointGoal) and lift.lifted.element.volume != "mean":
                goals |= {name: replace(goals[name], of_body=largest) for name in goal.names}
            elif self._options.asked and (size_of_change := getattr(goal, "size_of_change", None)):
                size = factor * size_of_change(lift.lifted, lift.start)
                goals |= {name: replace(goals[name], of_size=size) for name in goal.names}

    def _located(self) -> list[str]:
        """Return the goals whose errors are distributed to the cells."""
        least, asked, goals = _LOCATED, self._options.asked, self._estimate.goals
        if asked:
            least = min(least, _LOCATED_OF_ASKED * asked)
        names = [
            name
            for name, goal in goals.items()
            if goal.is_found and abs(goal.error or 0.0) > least * goal.scale
        ]
        if self._options.locate_all or not names:
            return names
        return [max(names, key=lambda name: abs(goals[name].error or 0.0) / goals[name].scale)]

    def _mesh_indicators(
        self, errors: Differences, mesh: Differences, chosen: Collection[str]
    ) -> dict[str, Array]:
        """Return the errors of chosen goals in cells, with what the lifted solution misses.

        Parameters
        ----------
        errors, mesh : Differences
            The errors without and with that part.
        chosen : collection of str
            The names of the goals.
        """
        ratios = np.full(len(errors.values), self._estimate.saturation)
        np.divide(mesh.values, errors.values, out=ratios, where=mesh.values * errors.values > 0)
        factors = dict(zip(names_of(self._given), ratios, strict=True))
        cells = cell_indicators(self.lift, self._given, chosen.__contains__)
        return {name: factors[name] * values for name, values in cells.items()}


def locks(problem: Problem, lifted: Element) -> bool:
    """Return whether the run's element locks: no decay of the lifted one's degrees shows that.

    P2 on triangles hardly does, nor does an element whose lifted one is of the same kind.
    """
    triangles = problem.element.name == "P2" and problem.kinematics.dim == 2
    same = lifted.volume == problem.element.volume
    return bool(may_lock(problem)) and not triangles and not same
