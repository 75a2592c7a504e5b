"""What a program asks of a solved problem: errors of goals, modes of vibration, reactions.

The functions are methods of `fem_snh.NonlinearProblem`, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy import estimate, path_errors
from fem_snh.accuracy.program_goals import program_goals
from fem_snh.problem import modes as vibrations
from fem_snh.problem import reactions
from fem_snh.problem.definition import lifted_problem
from fem_snh.problem.problem import check_converged

if TYPE_CHECKING:
    from fem_snh.accuracy.goal_errors import Estimate
    from fem_snh.nonlinear_problem import NonlinearProblem

Array = npt.NDArray[Any]


def estimate_error(problem: NonlinearProblem, goals: Mapping[str, Any] | Sequence[Any]) -> Estimate:
    """Estimate the errors of goals of the last solution, which does not change. Collective.

    The problem is solved once more, from its solution, in the element of the next degree on
    the same cells (docs/theory/error.md). Boundary values are interpolated from ``u``. In time,
    and with friction or multipliers, the path of `NonlinearProblem.steps` is followed again,
    from its first step. There is no estimate then after `NonlinearProblem.solve`, nor after
    `fem_snh.dynamic_problem.DynamicProblem.step`.

    Parameters
    ----------
    problem : NonlinearProblem
        The problem, at a solution.
    goals : sequence or mapping
        Each a point [x, y, z], or [x, y] (its displacement), a ``ufl.Measure`` (the mean
        displacement over its cells or facets, on a body of revolution of the whole turn), one
        of ``bcs`` (its reaction force), a pair of one and a point [x, y, z] (the moment of this
        force about it), an obstacle or a contact of ``terms`` (the force on the body or on the
        first surface), a cavity (its pressure), a rigid part (the displacement of its point),
        a pair of one and "displacement", "rotation", "force" or "moment", a UFL form of rank 0 in
        ``u``, "energy", "volume" (deformed over reference volume), "stress" (mean of von Mises'),
        a pair of a measure of cells and one of these two, or a triple of a point, "stress" and a
        radius [m] (its mean around the point). A mapping names them.

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
    discrete = problem._problem
    check_converged(problem.reason, "estimate_error")
    found = program_goals(discrete, goals)
    if problem._path:
        return path_errors.estimate_on_path(discrete, problem._path, found)
    return estimate.estimate_error(discrete, partial(lifted_problem, discrete), found)


def modes(
    problem: NonlinearProblem, count: int, density: float | None = None
) -> vibrations.VibrationModes:
    """Return the lowest modes of vibration about the last solution. Collective.

    They are those of small vibrations of the loaded body, with the exact Hessian and the
    consistent mass matrix, computed by SLEPc (python3-slepc4py-real). Its options have the
    solver's prefix, followed by ``modes_``: ``-snh_modes_eps_monitor``.

    Parameters
    ----------
    problem : NonlinearProblem
        The problem, at a solution.
    count : int
        Number of modes, from the lowest.
    density : float, optional
        Mass per reference volume [kg/m^3] of the materials that ``densities`` does not have,
        and of a body without materials, whose energy is in UFL.

    Returns
    -------
    VibrationModes
        ``frequencies`` [Hz] and ``shapes``, dolfinx Functions.

    Raises
    ------
    BadInput
        On every rank: before a solution, for a missing density, more modes than free dofs, an
        element with an unknown pressure, a force or a material without an energy, a cavity, a
        motion in time; or if the eigenvalue solver fails.

    Examples
    --------
    >>> modes = problem.vibration_modes(3, density=1000.0)
    >>> print(modes.frequencies[0], modes.shapes[0].x.array.max())
    """
    with problem._given.active():
        return vibrations.program_modes(
            problem._problem, count, density, problem._prefix, problem.reason
        )


def reaction(
    problem: NonlinearProblem, condition: Any, about: Sequence[float] | None = None
) -> Array:
    """Return the force (3,) [N] that a condition exerts on the body, or its moment. Collective.

    Parameters
    ----------
    problem : NonlinearProblem
        The problem.
    condition : dolfinx DirichletBC, Hold, Move or Symmetry
        One of the problem's ``bcs``. What several constrain counts for the last, which sets the
        value; a plane of symmetry has what no other condition sets.
    about : (3,) sequence of float, optional
        A point [m], about which the moment [N m] of the force at the deformed positions is
        returned in its place; a body of revolution has the moment of the whole turn.

    Raises
    ------
    BadInput
        On every rank, for another condition or object, and for anything but a point.

    Examples
    --------
    >>> torque = fem_snh.reaction(problem, bcs[1], about=[0, 0, 0])[2]
    """
    problem._read_displacement()
    discrete = problem._problem
    weights = reactions.counted_weights(discrete, condition)
    if about is None:
        return np.asarray(reactions.reaction(discrete, weights)[0])
    point = reactions.three_numbers("about", about)
    return np.asarray(reactions.reaction(discrete, weights, point)[1])


def reaction_moment(
    problem: NonlinearProblem, condition: Any, about: Sequence[float] = (0, 0, 0)
) -> Array:
    """Return the moment (3,) [N m] of a condition's force about a point: see `reaction`."""
    return reaction(problem, condition, about)
