"""The goals of a dolfinx program: points, measures, conditions and functionals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    TermGoal,
    VolumeGoal,
    names_of,
)
from fem_snh.accuracy.path_errors import Path, estimate_on_path
from fem_snh.accuracy.rigid_goals import RigidGoal
from fem_snh.errors import bad_value, check_number, check_whole, choose
from fem_snh.problem.dolfinx_problem import DolfinxConditions, check_converged
from fem_snh.problem.lifted_problem import lifted_problem
from fem_snh.problem.problem import Problem
from fem_snh.problem.program_modes import ProgramModes
from fem_snh.problem.program_reactions import (
    condition_number,
    counted_mask,
    three_numbers,
)
from fem_snh.tables.types import surface_name
from fem_snh.terms.body import measure_parts
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
        assert isinstance(problem.dirichlet, DolfinxConditions)
        found = program_goals(problem, problem.dirichlet.bcs, goals)
        if self._path:
            return estimate_on_path(problem, self._path, found)
        return estimate_error(problem, partial(lifted_problem, problem), found)


def program_goals(problem: Problem, bcs: Sequence[Any], goals: Any) -> list[Goal]:
    """Return the goals of a program.

    Parameters
    ----------
    problem : Problem
        Its problem.
    bcs : sequence of dolfinx DirichletBC
        Its conditions.
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
        key = f"goals[{name or number}]"
        frequencies = _frequencies(problem, name, key, goal)
        found += frequencies or [_goal(problem, bcs, name, goal, number)]
    of_modes = {id(goal.modes) for goal in found if isinstance(goal, FrequencyGoal)}
    if len(of_modes) > 1:
        accepted = "frequencies of one call of vibration_modes()"
        raise bad_value("goals", f"frequencies of {len(of_modes)} calls", accepted)
    names = names_of(found)
    if doubled := {name for name in names if names.count(name) > 1}:
        raise bad_value("goals", sorted(doubled)[0], "a different name for each goal")
    return found


def _goal(problem: Problem, bcs: Sequence[Any], name: str, goal: Any, number: int) -> Goal:
    key, kinematics = f"goals[{name or number}]", problem.kinematics
    components = range(kinematics.components)
    if isinstance(goal, str) and goal == "energy":
        if problem.motion:  # of which another sum is the energy
            raise bad_value(key, goal, "another goal, in time")
        if not problem.has_energy:
            raise bad_value(key, goal, "another goal, with a force without an energy")
        return EnergyGoal(name or goal)
    if of_cells := _of_cells(problem, name, key, goal):
        return of_cells
    if isinstance(goal, str):
        raise bad_value(key, goal, _ACCEPTED)
    if isinstance(goal, tuple) and len(goal) == 3 and goal[1] == "stress" and problem.regions:
        from fem_snh.accuracy.stress_goals import PointStressGoal  # imports sympy

        check_number(f"{key} radius", goal[2], 0.0, exclusive=True)
        centre = _point(goal[0], kinematics.dim)
        if centre is None:
            raise bad_value(key, goal, _ACCEPTED)
        return PointStressGoal(name or f"{key}.stress", centre, goal[2], problem.domain)
    if isinstance(goal, ufl.Form):
        if goal.arguments() or problem.u not in goal.coefficients():
            raise bad_value(key, "a form", "a form of rank 0 that contains u")
        return FunctionalGoal(name or key, goal, problem.u)
    if _dolfinx.is_measure(goal, facets=True):
        return MeanGoal(name or f"mean {number}", goal, components)
    part, result = goal if isinstance(goal, tuple) and len(goal) == 2 else (goal, RESULTS[0])
    if isinstance(part, Rigid) and any(part is term for term in problem.given_terms):
        choose(key, result, RESULTS)
        of_axes = kinematics.moment_axes if result in ("rotation", "moment") else kinematics.axes
        if not of_axes:
            raise bad_value(key, result, f"a motion of kinematics = '{kinematics.name}'")
        return RigidGoal(part.label, result, [*map(AXES.index, of_axes)], name)
    if isinstance(goal, Feature) and (result := _result(problem, goal)):
        return TermGoal(result, components if result.endswith(".force") else (), name)
    if hasattr(goal, "dof_indices"):
        i = condition_number(bcs, goal, key)
        return ReactionGoal(name or f"bcs[{i}].force", partial(counted_mask, number=i), components)
    if isinstance(goal, tuple) and len(goal) == 2 and hasattr(goal[0], "dof_indices"):
        i, about = condition_number(bcs, goal[0], key), three_numbers(key, goal[1])
        mask, axes = partial(counted_mask, number=i), kinematics.moment_axes
        if not axes:
            raise bad_value(key, "a moment", f"a force, with kinematics = '{kinematics.name}'")
        return ReactionGoal(name or f"bcs[{i}].moment", mask, [*map(AXES.index, axes)], about)
    if (place := _point(goal, kinematics.dim)) is None:
        raise bad_value(key, goal, _ACCEPTED)
    shown = f"({', '.join(f'{x:g}' for x in np.ravel(goal))})"
    return PointGoal(name or shown, place, components)


def _frequencies(problem: Problem, name: str, key: str, goal: Any) -> list[Goal]:
    """Return the frequencies of modes, or of a pair of them and a number; none of others."""
    modes, number = goal if isinstance(goal, tuple) and len(goal) == 2 else (goal, None)
    if not isinstance(modes, ProgramModes):
        return []
    lowest = modes.of_state(problem)
    if lowest is None:
        accepted = "those about the last solution: call vibration_modes()"
        raise bad_value(key, "modes of another state", accepted)
    if number is not None:
        check_whole(f"{key} number", number, 1, len(modes.frequencies))
        return [FrequencyGoal(number, lowest, name)]
    numbers = range(1, len(modes.frequencies) + 1)
    return [FrequencyGoal(i, lowest, name and f"{name}.{i}") for i in numbers]


def _point(given: Any, dim: int) -> list[float] | None:
    """Return a point [x, y, z], of a plane also [x, y]; None for what is none."""
    try:
        point = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        return None
    if point.shape not in ((3,), (dim,)) or not np.isfinite(point).all():
        return None
    return [*map(float, point), *[0.0] * (3 - len(point))]


def _of_cells(problem: Problem, name: str, key: str, goal: Any) -> Goal | None:
    """Return a volume or a stress of the body, or of a pair's measure of cells; None for others."""
    measure, kind = goal if isinstance(goal, tuple) and len(goal) == 2 else (None, goal)
    if not isinstance(kind, str) or kind not in ("volume", "stress") or not problem.regions:
        return None
    cells, label = None, name or kind
    if measure is not None:
        if not _dolfinx.is_measure(measure, facets=True):
            return None
        dim, cells = measure_parts(problem.domain, key, measure)
        if dim < problem.domain.topology.dim:
            raise bad_value(key, surface_name(measure), "a measure of cells, dx(...)")
        cells, label = cells[cells < _dolfinx.num_owned(problem.domain)], name or f"{key}.{kind}"
    if kind == "volume":
        return VolumeGoal(label, cells)
    from fem_snh.accuracy.stress_goals import StressGoal  # imports sympy

    return StressGoal(label, cells)


def _result(problem: Problem, feature: Feature) -> str:
    """Return the name of the goal that a term of the program has; "" if it has none."""
    alike = [term for term in problem.given_terms if type(term) is type(feature)]
    found = zip(alike, type(feature).goals(alike), strict=False)
    return next((name for term, name in found if term is feature), "")
