"""Results of a solved problem in a dolfinx program: errors of goals, vibration modes, reactions.

The functions are also methods of `fem_snh.NonlinearProblem`: ``estimate_error``,
``vibration_modes``, ``reaction_force`` and ``reaction_moment``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from fem_snh.accuracy import estimate, path_errors
from fem_snh.arrays import Array
from fem_snh.problem import modes as vibrations
from fem_snh.problem import reactions
from fem_snh.problem.definition import lifted_problem
from fem_snh.problem.problem import check_converged
from fem_snh.problem.program_goals import program_goals

if TYPE_CHECKING:
    from fem_snh.accuracy.goal_errors import Estimate
    from fem_snh.nonlinear_problem import NonlinearProblem


def estimate_error(problem: NonlinearProblem, goals: Mapping[str, Any] | Sequence[Any]) -> Estimate:
    """Estimate the errors of goals of the last solution, which stays unchanged. Collective.

    A problem with the element of the next degree on the same cells is solved, starting from the
    solution (docs/theory/error.md). Boundary values are interpolated from ``u``. If the body moves
    in time, or a term has friction or multipliers, all steps of `NonlinearProblem.steps` are
    solved again instead; there is then no estimate after `NonlinearProblem.solve` or
    `fem_snh.dynamic_problem.DynamicProblem.step`.

    Parameters
    ----------
    problem : NonlinearProblem
        The problem, at a solution.
    goals : sequence or mapping
        The goals, or a mapping of names to goals. A goal is

        - a point [x, y, z] or [x, y] [m]: its displacement;
        - a ``ufl.Measure``: the mean displacement over its cells or facets;
        - one of ``bcs``: its reaction force;
        - a pair (one of ``bcs``, point [x, y, z]): the moment of the reaction about the point;
        - an obstacle or a contact of ``terms``: its force on the body, or on the first surface;
        - a cavity of ``terms``: its pressure;
        - a rigid part of ``terms``, alone or in a pair with "displacement" (of its point, the
          default), "rotation", "force" or "moment";
        - a UFL form of rank 0 in ``u``: its value;
        - "energy"; "volume", the deformed over the reference volume; "stress", the mean von Mises
          stress; or a pair (measure of cells, "volume" or "stress");
        - a triple (point, "stress", radius [m]): the mean von Mises stress around the point.

    Returns
    -------
    Estimate
        ``goals`` has the value, error and corrected value of each goal by name; ``reason`` is empty
        or says why there is no estimate. ``print`` shows a line for each goal.

    Raises
    ------
    BadInput
        On every rank, for an object that is no goal, and if the last solve did not converge.

    Examples
    --------
    >>> print(problem.estimate_error({"corner": [48, 60, 0.5], "pull": bcs[1]}))
    corner.y 6.631, estimated error +0.266 (4.0 %), corrected 6.897
    """
    discrete = problem._problem
    check_converged(problem.reason, "estimate_error")
    found = program_goals(discrete, goals)
    if problem._path:
        known = path_errors.estimate_on_path(discrete, problem._path, found)
    else:
        known = estimate.estimate_error(discrete, partial(lifted_problem, discrete), found)
    if not known.reason:
        known.left_out.append(estimate.without_bounds("a program has one mesh"))
    return known


def modes(
    problem: NonlinearProblem, count: int, density: float | None = None
) -> vibrations.VibrationModes:
    """Return the lowest modes of vibration about the last solution. Collective.

    SLEPc (python3-slepc4py-real) computes the modes of small vibrations of the loaded body, with
    the exact Hessian and the consistent mass matrix. SLEPc's options have the solver's prefix,
    followed by ``modes_``: ``-snh_modes_eps_monitor``.

    Parameters
    ----------
    problem : NonlinearProblem
        The problem, at a solution.
    count : int
        Number of modes, from the lowest.
    density : float, optional
        Mass per reference volume [kg/m^3] of materials that are not in ``densities``, and of a
        body whose energy is in UFL, without materials.

    Returns
    -------
    VibrationModes
        ``frequencies`` [Hz] and ``shapes``, dolfinx Functions.

    Raises
    ------
    BadInput
        On every rank: if the last solve did not converge, a density is missing, or ``count``
        exceeds the number of free dofs; for an element with an unknown pressure, a force or a
        material without an energy, a cavity, a motion in time; or if the eigenvalue solver fails.

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
        One of the problem's ``bcs``. If several conditions constrain a dof, its force counts for
        the last of them, which sets the value; planes of symmetry come before all others.
    about : (3,) sequence of float, optional
        A point [m]. If it is given, the moment (3,) [N m] about it, of the nodal forces at their
        deformed positions, is returned instead. On a body of revolution it is of the whole turn.

    Raises
    ------
    BadInput
        On every rank, for an object that is none of ``bcs``, and for an invalid point.

    Examples
    --------
    >>> torque = fem_snh.reaction(problem, bcs[1], about=[0, 0, 0])[2]
    """
    problem._read_displacement()
    discrete = problem._problem
    weights = reactions.counted_weights(discrete, condition)
    if about is None:
        return np.asarray(reactions.reaction(discrete, weights)[0])
    point = reactions.check_point("about", about)
    return np.asarray(reactions.reaction(discrete, weights, point)[1])


def reaction_moment(
    problem: NonlinearProblem, condition: Any, about: Sequence[float] = (0, 0, 0)
) -> Array:
    """Return the moment (3,) [N m] of a condition's force about a point [m]. Collective.

    See `reaction`.
    """
    return reaction(problem, condition, about)
