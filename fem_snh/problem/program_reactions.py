"""The reactions of the conditions of a dolfinx program."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.errors import bad_value
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import reaction

Array = npt.NDArray[np.float64]


class HasReactions:
    """Forces and moments of conditions, methods of `fem_snh.NonlinearProblem`."""

    _problem: Problem

    def reaction_force(self, condition: Any) -> Array:
        """Return the force (3,) [N] that a condition exerts on the body. Collective.

        Parameters
        ----------
        condition : dolfinx DirichletBC
            One of the problem's ``bcs``. What several constrain counts for the last, which sets
            the value.

        Raises
        ------
        BadInput
            On every rank, for another condition or object.
        """
        self._read_displacement()
        return np.asarray(reaction(self._problem, condition_mask(self._problem, condition))[0])

    def reaction_moment(self, condition: Any, about: Sequence[float] = (0, 0, 0)) -> Array:
        """Return the moment (3,) [N m] that a condition exerts on the body. Collective.

        The moment is that of the forces at the deformed positions; a body of revolution has that of
        the whole turn.

        Parameters
        ----------
        condition : dolfinx DirichletBC
            One of the problem's ``bcs``. What several constrain counts for the last, which sets
            the value.
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
        mask = condition_mask(self._problem, condition)
        return np.asarray(reaction(self._problem, mask, three_numbers("about", about))[1])

    def _read_displacement(self) -> None:
        raise NotImplementedError


def condition_mask(problem: Problem, condition: Any, key: str = "condition") -> Any:
    """Return the owned dofs that a condition sets, (nodes, components) bool. Collective.

    Raises
    ------
    BadInput
        On every rank, for what is not one of the problem's ``bcs``.
    """
    conditions: Any = problem.dirichlet
    return counted_mask(problem, condition_number(conditions.bcs, condition, key))


def counted_mask(problem: Problem, number: int) -> Any:
    """Return the owned dofs of a condition by its number that no later one sets. Collective."""
    conditions: Any = problem.dirichlet
    mask, *later = conditions.masks[number:]
    return (mask & ~np.logical_or.reduce([*later, np.zeros_like(mask)]))[: len(problem.coordinates)]


def condition_number(bcs: Sequence[Any], condition: Any, key: str) -> int:
    """Return the index of a condition; raise BadInput for anything but one of ``bcs``."""
    for number, bc in enumerate(bcs):
        if bc is condition:
            return number
    found = "a condition" if hasattr(condition, "dof_indices") else condition
    raise bad_value(key, found, "one of the problem's bcs")


def three_numbers(key: str, value: Any) -> list[float]:
    """Return three finite numbers as floats; raise BadInput for anything else."""
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise bad_value(key, value, "a point [x, y, z]")
    return [float(x) for x in numbers]
