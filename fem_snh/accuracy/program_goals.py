"""The goals of a dolfinx program: points, measures, conditions and functionals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.accuracy.estimate import estimate_error
from fem_snh.accuracy.frequency_goals import FrequencyGoal
from fem_snh.accuracy.goal_errors import Estimate
from fem_snh.accuracy.goals import (
    AXES,
    EnergyGoal,
    FunctionalGoal,
    Goal,
    MeanGoal,
    PointGoal,
    ReactionGoal,
    RigidGoal,
    TermGoal,
    VolumeGoal,
    names_of,
)
from fem_snh.accuracy.path_errors import Path, estimate_on_path
from fem_snh.assembly.groups import cells_or_facets
from fem_snh.errors import BadInput, bad_value, check_number, check_whole, choose
from fem_snh.problem.conditions import condition_of, is_condition
from fem_snh.problem.definition import lifted_problem
from fem_snh.problem.modes import ProgramModes
from fem_snh.problem.problem import Problem, check_converged
from fem_snh.problem.reactions import (
    counted_weights,
    three_numbers,
)
from fem_snh.tables.types import surface_name
from fem_snh.terms.feature import Feature
from fem_snh.terms.rigid import RESULTS, Rigid

_ACCEPTED = (
    "a point [x, y, z], a measure (mean displacement), a condition of the problem (its force), "
    "a pair of a condition and a point (the moment of its force about it), "
    "an obstacle, a contact (its force) or a cavity (its pressure) of its terms, a rigid part (its "
    "displacement) or a pair of one and 'displacement', 'rotation', 'force' or 'moment', "
    "vibration modes (their frequencies) or a pair of them and a number, "
    "a UFL form of rank 0 in u, 'energy', 'volume', 'stress', a pair of a measure of cells and "
    "one of the last two, or ([x, y, z], 'stress', radius)"
)


class EstimatesErrors:
    """The estimate of errors, a method of `fem_snh.NonlinearProblem`."""

    _problem: Problem
    _path: Path | None
    reason: str

    def estimate_error(self, goals: Mapping[str, Any] | Sequence[Any]) -> Estimate:
        """Estimate the errors of goals of the last solution, which does not change. Collective.

        The problem is solved once more, from its solution, in the element of the next degree on
        the same cells (docs/theory/error.md). Boundary values are interpolated from ``u``. In time,
        and with friction or multipliers, the path of `NonlinearProblem.steps` is followed again,
        from its first step. There is no estimate then after `NonlinearProblem.solve`, nor after
        `fem_snh.dynamic_problem.DynamicProblem.step`.

        Parameters
        ----------
        goals : sequence or mapping
            Each a point [x, y, z], or [x, y] (its displacement), a ``ufl.Measure`` (the mean
            displacement over its cells or facets, on a body of revolution of the whole turn), one
            of ``bcs`` (its reaction force), a pair of one and a point [x, y, z] (the moment of this
            force about it), an obstacle or a contact of ``terms`` (the force on the body or on the
            first surface), a cavity (its pressure), a rigid part (the displacement of its point),
            a pair of one and "displacement", "rotation", "force" or "moment", the modes about this
            solution that `vibration_modes` returns (all their frequencies), a pair of them and a
            number from 1 (one frequency), a UFL form of rank 0 in ``u``, "energy", "volume"
            (deformed over reference volume), "stress" (mean of von Mises'), a pair of a measure of
            cells and one of these two, or a triple of a point, "stress" and a radius [m] (its mean
            around the point). A mapping names them.

        Returns
        -------
        Estimate
            ``goals`` has the value, error and corrected value of each; ``reason`` says why there
            is no estimate, if there is none. It prints as a line for each goal.

        Raises
        ------
        BadInput
            On every rank, for what is no goal, and before a solution.

        Examples
        --------
        >>> print(problem.estimate_error({"corner": [48, 60, 0.5], "pull": bcs[1]}))
        corner.y 6.631, error +0.266 (4.0 %), corrected 6.897
        """
        problem = self._problem
        check_converged(self.reason, "estimate_error")
        found = program_goals(problem, goals)
        if self._path:
            return estimate_on_path(problem, self._path, found)
        return estimate_error(problem, partial(lifted_problem, problem), found)


def program_goals(problem: Problem, goals: Any) -> list[Goal]:
    """Return the goals of a program.

    Parameters
    ----------
    problem : Problem
        Its problem.
    goals : mapping or sequence
        The goals, by name or in a list.

    Raises
    ------
    BadInput
        On every rank, for what is no goal.
    """
    if isinstance(goals, Mapping):
        named = [(str(name), goal) for name, goal in goals.items()]
    elif isinstance(goals, Sequence) and not isinstance(goals, str):
        named = [("", goal) for goal in goals]
    else:
        raise bad_value("goals", goals, "a list of goals, or a mapping of names to goals")
    if not named:
        raise bad_value("goals", goals, "at least one goal")
    found: list[Goal] = []
    for number, (name, goal) in enumerate(named):
        found += _goals(_Given(problem, name, number, goal))
    of_modes = {id(goal.modes) for goal in found if isinstance(goal, FrequencyGoal)}
    if len(of_modes) > 1:
        accepted = "frequencies of one call of vibration_modes()"
        raise bad_value("goals", f"frequencies of {len(of_modes)} calls", accepted)
    names = names_of(found)
    if doubled := {name for name in names if names.count(name) > 1}:
        raise bad_value("goals", sorted(doubled)[0], "a different name for each goal")
    return found


@dataclass(frozen=True)
class _Given:
    """What a program gives for a goal.

    Attributes
    ----------
    problem : Problem
        Its problem.
    name : str
        The name of the goal; "" for that of its kind.
    number : int
        Its place among the goals.
    value : object
        What is given.
    """

    problem: Problem
    name: str
    number: int
    value: Any

    @property
    def key(self) -> str:
        """The goal's name in messages."""
        return f"goals[{self.name or self.number}]"

    @property
    def pair(self) -> tuple[Any, Any]:
        """The value and what is given with it; None for nothing."""
        is_pair = isinstance(self.value, tuple) and len(self.value) == 2
        return self.value if is_pair else (self.value, None)

    def refused(self, value: object, accepted: str) -> BadInput:
        """Return the error for a value of this goal."""
        return bad_value(self.key, value, accepted)


def _frequencies(given: _Given) -> list[Goal]:
    """Frequencies of modes, or of a pair of them and a number."""
    (modes, number), name = given.pair, given.name
    if not isinstance(modes, ProgramModes):
        return []
    lowest = modes.of_state(given.problem)
    if lowest is None:
        accepted = "those about the last solution: call vibration_modes()"
        raise given.refused("modes of another state", accepted)
    if number is not None:
        check_whole(f"{given.key} number", number, 1, len(modes.frequencies))
        return [FrequencyGoal(number, lowest, name)]
    numbers = range(1, len(modes.frequencies) + 1)
    return [FrequencyGoal(i, lowest, name and f"{name}.{i}") for i in numbers]


def _energy(given: _Given) -> list[Goal]:
    if not (isinstance(given.value, str) and given.value == "energy"):
        return []
    if given.problem.motion:  # of which another sum is the energy
        raise given.refused(given.value, "another goal, in time")
    if not given.problem.has_energy:
        raise given.refused(given.value, "another goal, as a load or a material has no energy")
    return [EnergyGoal(given.name or given.value)]


def _volume_or_stress(given: _Given) -> list[Goal]:
    """The volume or the stress of the body, or of a pair's measure of cells."""
    problem, (measure, kind) = given.problem, given.pair
    if kind is None:
        measure, kind = None, given.value
    if not isinstance(kind, str) or kind not in ("volume", "stress") or not problem.regions:
        return []
    cells, label = None, given.name or kind
    if measure is not None:
        if not _dolfinx.is_measure(measure, facets=True):
            return []
        dim, cells = cells_or_facets(problem.definition.mesh, given.key, measure)
        if dim < problem.domain.topology.dim:
            raise given.refused(surface_name(measure), "a measure of cells, dx(...)")
        cells = cells[cells < _dolfinx.num_owned(problem.domain)]
        label = given.name or f"{given.key}.{kind}"
    if kind == "volume":
        return [VolumeGoal(label, cells)]
    from fem_snh.accuracy.stress_goals import StressGoal  # imports sympy

    return [StressGoal(label, cells)]


def _stress_at_point(given: _Given) -> list[Goal]:
    value, problem = given.value, given.problem
    is_kind = isinstance(value, tuple) and len(value) == 3 and value[1] == "stress"
    if not (is_kind and problem.regions):
        return []
    from fem_snh.accuracy.stress_goals import PointStressGoal  # imports sympy

    place, _, radius = value
    check_number(f"{given.key} radius", radius, 0.0, exclusive=True)
    centre = _point(place, problem.kinematics.dim)
    if centre is None:
        raise given.refused(value, _ACCEPTED)
    return [PointStressGoal(given.name or f"{given.key}.stress", centre, radius, problem.domain)]


def _functional(given: _Given) -> list[Goal]:
    form, u = given.value, given.problem.u
    if not isinstance(form, ufl.Form):
        return []
    if form.arguments() or u not in form.coefficients():
        raise given.refused("a form", "a form of rank 0 that contains u")
    return [FunctionalGoal(given.name or given.key, form, u)]


def _mean(given: _Given) -> list[Goal]:
    if not _dolfinx.is_measure(given.value, facets=True):
        return []
    components = range(given.problem.kinematics.components)
    return [MeanGoal(given.name or f"mean {given.number}", given.value, components)]


def _rigid_part(given: _Given) -> list[Goal]:
    problem, (part, result) = given.problem, given.pair
    if not (isinstance(part, Rigid) and any(part is term for term in problem.definition.terms)):
        return []
    result, kinematics = RESULTS[0] if result is None else result, problem.kinematics
    choose(given.key, result, RESULTS)
    axes = kinematics.moment_axes if result in ("rotation", "moment") else kinematics.axes
    if not axes:
        raise given.refused(result, f"a motion of kinematics = '{kinematics.name}'")
    return [RigidGoal(part.label, result, [*map(AXES.index, axes)], given.name)]


def _term(given: _Given) -> list[Goal]:
    """The force of contact, or the pressure of a cavity."""
    problem, feature = given.problem, given.value
    if not isinstance(feature, Feature):
        return []
    alike = [term for term in problem.definition.terms if type(term) is type(feature)]
    named = zip(alike, type(feature).goals(alike), strict=False)
    result = next((name for term, name in named if term is feature), "")
    if not result:
        return []
    components = range(problem.kinematics.components) if result.endswith(".force") else ()
    return [TermGoal(result, components, given.name)]


def _reaction(given: _Given) -> list[Goal]:
    """The force of a condition, or its moment about the point of a pair."""
    (condition, about), kinematics = given.pair, given.problem.kinematics
    if not is_condition(condition):
        return []
    label = condition_of(given.problem.dirichlet, condition, given.key).label
    weights = partial(counted_weights, condition=condition)
    if about is None:
        name, components = given.name or f"{label}.force", range(kinematics.components)
        return [ReactionGoal(name, weights, components)]
    point, axes = three_numbers(given.key, about), kinematics.moment_axes
    if not axes:
        raise given.refused("a moment", f"a force, with kinematics = '{kinematics.name}'")
    name = given.name or f"{label}.moment"
    return [ReactionGoal(name, weights, [*map(AXES.index, axes)], point)]


def _displacement(given: _Given) -> list[Goal]:
    """The displacement of a point."""
    kinematics = given.problem.kinematics
    if (place := _point(given.value, kinematics.dim)) is None:
        return []
    shown = f"({', '.join(f'{x:g}' for x in np.ravel(given.value))})"
    return [PointGoal(given.name or shown, place, range(kinematics.components))]


#: The kinds of goals. Each function returns the goals of what it accepts, and none of others.
_KINDS: Sequence[Callable[[_Given], list[Goal]]] = (
    _frequencies,
    _energy,
    _volume_or_stress,
    _stress_at_point,
    _functional,
    _mean,
    _rigid_part,
    _term,
    _reaction,
    _displacement,
)


def _goals(given: _Given) -> list[Goal]:
    for kind in _KINDS:
        if goals := kind(given):
            return goals
    raise given.refused(given.value, _ACCEPTED)


def _point(given: Any, dim: int) -> list[float] | None:
    """Return a point [x, y, z], of a plane also [x, y]; None for what is none."""
    try:
        point = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        return None
    if point.shape not in ((3,), (dim,)) or not np.isfinite(point).all():
        return None
    return [*map(float, point), *[0.0] * (3 - len(point))]
