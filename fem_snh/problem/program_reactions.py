"""The reactions of the conditions of a dolfinx program."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.boundary_conditions import take_direction
from fem_snh.errors import bad_value
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import reaction
from fem_snh.terms.symmetry import Symmetry

Array = npt.NDArray[np.float64]


class HasReactions:
    """Forces and moments of conditions, methods of `fem_snh.NonlinearProblem`."""

    _problem: Problem

    def reaction_force(self, condition: Any) -> Array:
        """Return the force (3,) [N] that a condition exerts on the body. Collective.

        Parameters
        ----------
        condition : dolfinx DirichletBC or Symmetry
            One of the problem's ``bcs``. What several constrain counts for the last, which sets
            the value; a plane of symmetry has what no condition of dolfinx sets.

        Raises
        ------
        BadInput
            On every rank, for another condition or object.
        """
        self._read_displacement()
        return np.asarray(reaction(self._problem, condition_weights(self._problem, condition))[0])

    def reaction_moment(self, condition: Any, about: Sequence[float] = (0, 0, 0)) -> Array:
        """Return the moment (3,) [N m] that a condition exerts on the body. Collective.

        The moment is that of the forces at the deformed positions; a body of revolution has that of
        the whole turn.

        Parameters
        ----------
        condition : dolfinx DirichletBC or Symmetry
            One of the problem's ``bcs``. What several constrain counts for the last, which sets
            the value; a plane of symmetry has what no condition of dolfinx sets.
        about : (3,) sequence of float, optional
            The point [m].

        Raises
        ------
        BadInput
            On every rank, for another condition or object, and for anything but a point.

        Examples
        --------
        >>> torque = problem.reaction_moment(bcs[1], about=[0, 0, 0])[2]
        """
        self._read_displacement()
        weights = condition_weights(self._problem, condition)
        return np.asarray(reaction(self._problem, weights, three_numbers("about", about))[1])

    def _read_displacement(self) -> None:
        raise NotImplementedError


def condition_weights(problem: Problem, condition: Any) -> Array:
    """Return the parts of the owned nodes' forces that a condition exerts. Collective.

    They are those of `counted_weights`.

    Raises
    ------
    BadInput
        On every rank, for what is not one of the problem's ``bcs``.
    """
    conditions: Any = problem.dirichlet
    return counted_weights(problem, condition_number(conditions.given, condition, "condition"))


def counted_weights(problem: Problem, number: int) -> Array:
    """Return the parts of the owned nodes' forces that a condition exerts. Collective.

    Parameters
    ----------
    problem : Problem
        A problem of a program, or the lifted one.
    number : int
        The condition's place in ``bcs``.

    Returns
    -------
    (nodes, components, components) array
        The projections on the directions that it sets, and that no later one does: see
        `fem_snh.assembly.boundary_conditions.counted_forces`.
    """
    conditions: Any = problem.dirichlet
    owned, components = len(problem.coordinates), problem.kinematics.components
    taken, units = np.zeros((owned, components, components)), np.eye(components)
    in_rigid = divmod(conditions.released, components)
    taken[in_rigid] = units[in_rigid[1]]
    directions = {
        i: [(plane.nodes, plane.normal)]
        for i, plane in zip(conditions.symmetry_numbers, conditions.symmetry_planes, strict=True)
    }
    # Conditions of dolfinx override planes of symmetry, and earlier ones.
    for i, mask in zip(conditions.numbers, conditions.masks, strict=True):
        directions[i] = [(np.flatnonzero(m), unit) for m, unit in zip(mask.T, units, strict=True)]
    weights: Array = np.zeros_like(taken)
    for i, constrained in reversed(directions.items()):
        for nodes, normal in constrained:
            nodes = nodes[nodes < owned]
            parts, _ = take_direction(taken, nodes, normal)
            if i == number:
                weights[nodes] += parts
    return weights


def condition_number(bcs: Sequence[Any], condition: Any, key: str) -> int:
    """Return the index of a condition; raise BadInput for anything but one of ``bcs``."""
    for number, bc in enumerate(bcs):
        if bc is condition:
            return number
    found = "a condition" if is_condition(condition) else condition
    raise bad_value(key, found, "one of the problem's bcs")


def is_condition(given: Any) -> bool:
    """Whether an object is a condition of dolfinx or a plane of symmetry."""
    return hasattr(given, "dof_indices") or isinstance(given, Symmetry)


def three_numbers(key: str, value: Any) -> list[float]:
    """Return three finite numbers as floats; raise BadInput for anything else."""
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise bad_value(key, value, "a point [x, y, z]")
    return [float(x) for x in numbers]
