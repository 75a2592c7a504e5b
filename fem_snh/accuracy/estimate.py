"""Estimate the errors of goals: their values in the lifted problem less those of the run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.accuracy.differences import (
    Differences,
    LiftedGoals,
    saturation,
    scales_of,
)
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
    Lift,
    check_memory,
    create_in,
    create_lifted,
    element_of_factor,
    lifted_dofs,
    lifted_elements,
    memory,
)
from fem_snh.accuracy.penalties import penalty_errors
from fem_snh.assembly.elements import Element
from fem_snh.cache import Stopwatch
from fem_snh.contact.obstacle_contact import ObstacleContact
from fem_snh.errors import in_words
from fem_snh.mesh.mesh import Mesh
from fem_snh.mesh.round_faces import round_faces
from fem_snh.problem.goals import Goal, StressGoal, TermGoal, names_of
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import is_at_rest, may_lock
from fem_snh.solver import StepOutcome

Array = npt.NDArray[np.float64]
#: Goals are relative to the largest component of their vector that was asked for, or to this part
#: of the largest displacement or force, if that is more.
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
        _add_narrow_contacts(problem, estimate)
    except NoEstimate as reason:
        estimate.reason = str(reason)
        estimate.on_no_mesh = isinstance(reason, NoEstimateOnAnyMesh)
        estimate.steps_too_long = isinstance(reason, StepsTooLong)
    problem.split(problem.x)
    _mark_forces_without_contact(problem, goals, estimate)
    estimate.jit = watch.jit
    estimate.seconds = watch.seconds + estimate.jit


def without_bounds(why: str) -> str:
    """Return the line that estimates have no bound."""
    return f"estimates have no bound, which another mesh measures: {why}"


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
    errors: dict[str, GoalError] = {}
    vectors, at_rest = [goal.bind(problem)() for goal in goals], is_at_rest(problem)
    for goal, vector in zip(goals, vectors, strict=True):
        unit = goal.unit(problem)
        asked = [v for n, v in zip(goal.names, vector, strict=True) if n not in goal.unasked]
        scale = max(*map(abs, asked), _LEAST_SCALE * unit)
        if at_rest and (unit > 0 or goal.kind == "energy"):
            scale = inf  # a multiple of rounding has no relative error
        for name, value in zip(goal.names, vector, strict=True):
            errors[name] = GoalError(value, None, scale, asked=name not in goal.unasked)
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
                unknown = GoalError(known.value, None, known.scale, asked=known.asked)
                estimate.goals[name] = replace(unknown, reason=NO_CONTACT)


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
        outcome = StepOutcome()
        #: The part of the errors that penalties have, and what that may miss; None without any.
        self._penalties = penalty_errors(problem, goals, scales_of(estimate, goals), outcome)
        estimate.penalty_newton = outcome.newton
        self.lift = Lift(problem, lifted)
        self._goals = LiftedGoals(self.lift, goals, estimate)

    def add(self) -> None:
        """Add the errors to the estimate; raise NoEstimate if there are none."""
        estimate, options = self._estimate, self._options
        differences = self._goals.differences(options.asked)
        estimate.may_be_unstable = self.lift.check_stability(options.stability)
        mesh = differences + self._missed(differences)
        parts = {"mesh": (mesh.values, MISSED * np.abs(mesh.values))}
        if self._penalties is not None:
            parts["penalty"] = self._penalties
        set_parts(estimate, self._given, parts, mesh.unsettled)
        self._set_least()
        if chosen := self._located():
            estimate.indicators = self._mesh_indicators(differences, mesh, chosen)
        estimate.linear = self.lift.linear

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

    def _set_least(self) -> None:
        """Set the least bounds: of displacements from the field, which is one vector; of stresses.

        Errors of a stress on two sides of a point cancel in its mean. The field's errors are those
        at vertices: inside of cells the lifted displacement varies on any mesh.
        """
        lift, lifted, known = self.lift, self.lift.lifted, self._estimate.goals
        change = (lifted.x.array_r - lift.start.array_r)[: lifted.owned_displacements]
        nodes = change.reshape(-1, lifted.kinematics.components)
        corners = _dolfinx.cell_vertices(lifted.domain).shape[1]
        vertices = np.unique(_dolfinx.node_dofs(lifted.V)[:, :corners])
        sizes = np.abs(nodes[vertices[vertices < len(nodes)]])
        largest = lifted.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
        for goal in self._given:
            size = 0.0
            if goal.kind == "displacement":
                size = largest
            elif isinstance(goal, StressGoal):
                size = goal.size_of_change(lifted, lift.start)
            least = OF_VECTOR * MISSED * self._estimate.saturation * size
            known |= {name: replace(known[name], least=least) for name in goal.names}

    def _located(self) -> list[str]:
        """Return the goals whose errors are distributed to the cells."""
        least, asked, goals = _LOCATED, self._options.asked, self._estimate.goals
        if asked:
            least = min(least, _LOCATED_OF_ASKED * asked)
        names = [
            name
            for name, goal in goals.items()
            if goal.asked and goal.scale > 0 and abs(goal.of_mesh) > least * goal.scale
        ]
        if self._options.locate_all or not names:
            return names
        return [max(names, key=lambda name: abs(goals[name].estimate or 0.0) / goals[name].scale)]

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


def set_parts(
    estimate: Estimate,
    goals: Sequence[Goal],
    parts: Mapping[str, tuple[Array, Array]],
    unsettled: Array | None = None,
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
    unsettled : (goals,) array, optional
        What further iterations would change.
    """
    for i, name in enumerate(names_of(goals)):
        known = {source: float(part[i]) for source, (part, _) in parts.items() if part[i]}
        missed = {source: float(bound[i]) for source, (_, bound) in parts.items() if bound[i]}
        if unsettled is not None and unsettled[i]:
            missed["algebra"] = float(unsettled[i])
        total = sum(known.values())
        estimate.goals[name] = replace(
            estimate.goals[name], estimate=total, parts=known, missed=missed
        )


def locks(problem: Problem, lifted: Element) -> bool:
    """Return whether the run's element locks: no decay of the lifted one's degrees shows that.

    P2 on triangles hardly does, nor does an element whose lifted one is of the same kind.
    """
    triangles = problem.element.name == "P2" and problem.kinematics.dim == 2
    same = lifted.volume == problem.element.volume
    return bool(may_lock(problem)) and not triangles and not same
