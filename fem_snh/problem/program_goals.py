"""The goals of a dolfinx program: points, measures, conditions and functionals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.regions import cells_or_facets
from fem_snh.errors import BadInput, bad_value, check_number, choose
from fem_snh.problem.conditions import condition_of, is_condition
from fem_snh.problem.goals import (
    AXES,
    CellsGoal,
    EnergyGoal,
    FunctionalGoal,
    Goal,
    MeanGoal,
    PointGoal,
    PointStressGoal,
    ReactionGoal,
    RigidGoal,
    StressGoal,
    TermGoal,
    VolumeGoal,
    names_of,
)
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import check_point, counted_weights
from fem_snh.tables.types import surface_name
from fem_snh.terms.feature import Feature
from fem_snh.terms.rigid import RESULTS, Rigid

#: The goals of the body, or of cells of it.
_OF_CELLS: dict[str, type[CellsGoal]] = {"volume": VolumeGoal, "stress": StressGoal}
_ACCEPTED = (
    "a point [x, y, z], a measure, a condition, an obstacle, a contact or a cavity of its terms, a "
    "rigid part, vibration modes, a UFL form of rank 0 in u, 'energy', 'volume', 'stress', or a "
    "pair or triple that estimate_error describes"
)


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
        found += _goals(problem, number, name, goal)
    names = names_of(found)
    if doubled := {name for name in names if names.count(name) > 1}:
        raise bad_value("goals", sorted(doubled)[0], "a different name for each goal")
    return found


def _goals(problem: Problem, number: int, name: str, value: Any) -> list[Goal]:
    """Return the goals of what a program gives, in the place ``number`` or by a ``name``."""
    kinematics, key = problem.kinematics, f"goals[{name or number}]"
    every = range(kinematics.components)
    turned = [AXES.index(axis) for axis in kinematics.moment_axes]

    def refused(what: object, accepted: str) -> BadInput:
        return bad_value(key, what, accepted)

    match value:
        case str("energy"):
            if problem.motion:  # of which another sum is the energy
                raise refused(value, "another goal, in time")
            if not problem.has_energy:
                raise refused(value, "another goal, as a load or a material has no energy")
            return [EnergyGoal(name or value)]
        case str("volume" | "stress") if problem.regions:
            return [_OF_CELLS[value](name or value)]
        case (measure, str("volume" | "stress") as kind) if problem.regions:
            if _dolfinx.is_measure(measure, facets=True):
                dim, cells = cells_or_facets(problem.definition.mesh, key, measure)
                if dim < problem.domain.topology.dim:
                    raise refused(surface_name(measure), "a measure of cells, dx(...)")
                cells = cells[cells < _dolfinx.num_owned(problem.domain)]
                return [_OF_CELLS[kind](name or f"{key}.{kind}", cells)]
        case (place, str("stress"), radius) if problem.regions:
            check_number(f"{key} radius", radius, 0.0, exclusive=True)
            if (centre := _point(place, kinematics.dim)) is not None:
                return [PointStressGoal(name or f"{key}.stress", centre, radius, problem.domain)]
        case ufl.Form():
            if value.arguments() or problem.u not in value.coefficients():
                raise refused("a form", "a form of rank 0 that contains u")
            return [FunctionalGoal(name or key, value, problem.u)]
        case Rigid() | (Rigid(), _):
            part, result = (value, RESULTS[0]) if isinstance(value, Rigid) else value
            if any(part is term for term in problem.definition.terms):
                choose(key, result, RESULTS)
                turns = result in ("rotation", "moment")
                components = turned if turns else [AXES.index(axis) for axis in kinematics.axes]
                if not components:
                    raise refused(result, f"a motion of kinematics = '{kinematics.name}'")
                return [RigidGoal(part.label, result, components, name)]
        case Feature():  # the force of contact, or the pressure of a cavity
            alike = [term for term in problem.definition.terms if type(term) is type(value)]
            for term, result in zip(alike, type(value).goals(alike), strict=False):
                if term is value and result:
                    return [TermGoal(result, every if result.endswith(".force") else (), name)]
        case (condition, about) if is_condition(condition):
            label = condition_of(problem.dirichlet, condition, key).label
            centre = check_point(key, about)
            if not turned:
                raise refused("a moment", f"a force, with kinematics = '{kinematics.name}'")
            weights = partial(counted_weights, condition=condition)
            return [ReactionGoal(name or f"{label}.moment", weights, turned, centre)]
    if is_condition(value):
        label = condition_of(problem.dirichlet, value, key).label
        weights = partial(counted_weights, condition=value)
        return [ReactionGoal(name or f"{label}.force", weights, every)]
    if _dolfinx.is_measure(value, facets=True):
        return [MeanGoal(name or f"mean {number}", value, every)]
    if (point := _point(value, kinematics.dim)) is not None:
        shown = ", ".join(f"{x:g}" for x in np.ravel(value))
        return [PointGoal(name or f"({shown})", point, every)]
    raise refused(value, _ACCEPTED)


def _point(given: Any, dim: int) -> list[float] | None:
    """Return a point [x, y, z], of a plane also [x, y]; None for what is none."""
    try:
        point = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        return None
    if point.shape not in ((3,), (dim,)) or not np.isfinite(point).all():
        return None
    return [*map(float, point), *[0.0] * (3 - len(point))]
