"""The moduli of a problem without materials, from its terms."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.errors import bad_value
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]

#: Strain of the central difference in `_curvature`: about the cube root of the rounding error.
_STRAIN = 1e-5


def set_modulus(problem: Problem) -> None:
    """Set the moduli of a problem without materials, from its terms at the start.

    That of forces is 3 times the shear modulus, E of an incompressible material: the least
    curvature of the energy in three uniform shears. Without resistance to shear, as of springs, it
    is the mean entry on the Hessian's diagonal over the nodes' distance, which has the same unit.

    Raises
    ------
    BadInput
        If the curvature is negative in the shears and in a dilation: of residuals with the other
        sign, which a solver of equations does not notice.
    """
    dim, components = problem.kinematics.dim, problem.kinematics.components
    gradients = np.zeros((dim + 1, components, 3))
    for i in range(dim):
        gradients[i, i, (i + 1) % dim] = 1.0  # u_i = g X_j
    gradients[dim] = np.eye(components, 3)
    *shears, dilation = [_curvature(problem, gradient) for gradient in gradients]
    if max(*shears, dilation) < 0:
        accepted = "energies, or residuals that are their derivatives: the stiffness is negative "
        accepted += "in shear and in dilation; multiply the forms by -1"
        raise bad_value("terms", "forms of the other sign", accepted)
    modulus = 3 * min(shears)
    if not (isfinite(modulus) and modulus > 0):
        problem.jacobian(problem.x, "clamp")
        distance = problem.length * (problem.dofs / components) ** (-1 / dim)
        modulus = (problem.matrix.constrained_diagonal or 1.0) / distance
    volume_dimension = problem.kinematics.volume_dimension
    problem.modulus = modulus
    problem.force_scale = modulus * problem.length ** (volume_dimension - 1)


def _curvature(problem: Problem, gradient: Array) -> float:
    """The second derivative of the energy in u = g G X by g, per volume [Pa]. Collective."""
    force, moved = problem.x.duplicate(), problem.x.duplicate()
    moved.set(0.0)
    moved.array[: problem.owned_displacements] = (problem.coordinates @ gradient.T).ravel()
    works = []
    for sign in (1, -1):
        state = problem.x.copy()
        state.axpy(sign * _STRAIN, moved)
        problem.gradient(state, force)
        works.append(float(force.dot(moved)))
    volume = problem.length**problem.kinematics.volume_dimension
    return (works[0] - works[1]) / (2 * _STRAIN * volume)
