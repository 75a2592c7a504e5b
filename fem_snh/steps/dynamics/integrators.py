r"""Time integrators: velocity and acceleration at a step's end as affine functions of displacement.

With u the displacement at the end of a step of size h, every integrator has

.. math:: v = c_v (u - w_v), \qquad a = c_a (u - w_a),

whose rates c and origins w follow from the states before the step. The balance of forces

.. math:: k_1 M a + k_0 M a_0 + C v + f(u) + \kappa (f_0 + C v_0) = 0

is then the gradient of an energy in u (`fem_snh.steps.dynamics.motion_terms`,
docs/theory/dynamics.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from fem_snh.arrays import Array
from fem_snh.choices import DEFAULT_RHO_INFINITY, INTEGRATORS
from fem_snh.errors import bad_value, check_number, choose

#: A function that sets constrained directions of displacements (local dofs,) to zero, in place.
Project = Callable[[Array], None]


@dataclass(frozen=True)
class Affine:
    """An affine function of the displacement: rate * (u - origin).

    Attributes
    ----------
    rate : float
        The rate c.
    origin : (local dofs,)
        The displacement w [m] at which the function is zero.
    """

    rate: float
    origin: Array

    def __call__(self, u: Array) -> Array:
        """Return the function at a displacement, (local dofs,)."""
        return np.asarray(self.rate * (u - self.origin))

    def set_values(self, project: Project, u: Array, values: Array) -> None:
        """Change ``origin`` in constrained directions, so that the function is ``values`` at u."""
        origin = u - values / self.rate
        free = origin.copy()
        project(free)
        project(self.origin)
        self.origin[:] += origin - free


class Before(NamedTuple):
    """The step before a step: its size [s] and the motion at its start, as in `MotionState`."""

    size: float
    u: Array
    v: Array
    a: Array


@dataclass(frozen=True)
class MotionState:
    """The motion at the start of a step; arrays (local dofs,) with ghosts.

    Attributes
    ----------
    u, v, a : arrays
        Displacement [m], velocity [m/s], acceleration [m/s^2] without the part by mean forces.
    before : Before or None
        The step before; None at the beginning.
    """

    u: Array
    v: Array
    a: Array
    before: Before | None = None


@dataclass(frozen=True)
class StepFormulas:
    """The formulas of one step.

    Attributes
    ----------
    velocity, acceleration : Affine
        v and a at the step's end.
    old_acceleration : (local dofs,)
        The acceleration a_0 of the step's start.
    error : tuple of float
        Factors [s^2] of a and of a_0 in the displacement's local error.
    inertia : tuple of float
        (k_1, k_0), the weights of a and a_0 in the balance of forces.
    old_forces : float
        kappa, the weight of the forces at the step's start.
    gamma : float
        Weight of a in v / h. A mean force of the step with the acceleration F changes v by F h, so
        it adds F / gamma to a.
    tangent : float
        The part of a step after which ``velocity`` is tangent to the path of a body that rotates
        steadily: 1/2 for the chord (u - u_0) / h, 1 for a velocity of the step's end.
    """

    velocity: Affine
    acceleration: Affine
    old_acceleration: Array
    error: tuple[float, float]
    inertia: tuple[float, float] = (1.0, 0.0)
    old_forces: float = 0.0
    gamma: float = 1.0
    tangent: float = 1.0


class Integrator(Protocol):
    """A time integrator.

    Attributes
    ----------
    name : str
        The name in scenes.
    order : int
        The order of accuracy.
    num_steps : int
        Number of steps that the formulas contain.
    end_weight : float
        Weight of the forces at a step's end in the work that they do in the step.
    uses_old_forces : bool
        Whether the balance of a step contains the forces at its start.
    shift : float
        Time of the acceleration minus time of the step's end, as a part of the step.
    has_mean_forces : bool
        Whether contact with obstacles and between bodies enters the balance of a step by its mean
        over the step.
    """

    name: str
    order: int
    num_steps: int
    end_weight: float
    uses_old_forces: bool
    shift: float
    has_mean_forces: bool

    def formulas(self, h: float, state: MotionState) -> StepFormulas:
        """Return the formulas of a step of h seconds from a state."""


class BackwardEuler:
    """v = (u - u_0) / h, a = (v - v_0) / h. Order 1; damps all frequencies."""

    order, num_steps, end_weight = 1, 1, 1.0
    uses_old_forces, shift, has_mean_forces = False, 0.0, False

    def __init__(self, name: str = "backward_euler") -> None:
        self.name = name

    def formulas(self, h: float, state: MotionState) -> StepFormulas:
        """Return the formulas of a step; the local error is h^2 a / 2."""
        velocity = Affine(1 / h, state.u.copy())
        acceleration = Affine(1 / h**2, state.u + h * state.v)
        return StepFormulas(velocity, acceleration, state.a, (h**2 / 2, 0.0), tangent=0.5)


class BDF2:
    """Backward differences of second order with variable steps; the first step is backward Euler.

    Hairer, Norsett & Wanner 1993, section III.5. It is zero-stable while the ratio of a step to the
    step before is less than 1 + sqrt(2).
    """

    name, order, num_steps, end_weight = "bdf2", 2, 2, 1.0
    uses_old_forces, shift, has_mean_forces = False, 0.0, False

    def formulas(self, h: float, state: MotionState) -> StepFormulas:
        """Return the formulas of a step."""
        if state.before is None:
            return BackwardEuler().formulas(h, state)
        h_before, u_before, v_before, _ = state.before
        ratio = h / h_before
        k = (1 + 2 * ratio) / (1 + ratio)
        new, old = (1 + ratio) / k, -(ratio**2) / (1 + ratio) / k
        u, v = new * state.u + old * u_before, new * state.v + old * v_before
        error = h**2 * (1 + ratio) ** 2 / (6 * ratio * (1 + 2 * ratio))
        velocity, acceleration = Affine(k / h, u), Affine((k / h) ** 2, u + h / k * v)
        return StepFormulas(velocity, acceleration, state.a, (error, -error))


class GeneralizedAlpha:
    r"""The generalised-alpha method of Chung & Hulbert 1993, with Newmark's as a special case.

    .. math:: \alpha_m = \frac{2 \rho - 1}{\rho + 1}, \quad \alpha_f = \frac{\rho}{\rho + 1}, \quad
        \gamma = \tfrac12 - \alpha_m + \alpha_f, \quad
        \beta = \tfrac14 (1 - \alpha_m + \alpha_f)^2

    for a spectral radius rho at infinite frequency (their equations 25, 17 and 20).

    The acceleration belongs to the time t + (alpha_m - alpha_f) h (Arnold & Brüls 2007). If the
    step size h changes, a_0 is therefore extrapolated linearly.

    Parameters
    ----------
    alpha_m, alpha_f : float
        Weights of inertia and of the other forces at the step's start.
    name : str, optional
        The integrator's name.
    """

    order = 2

    def __init__(self, alpha_m: float, alpha_f: float, name: str = "generalized_alpha") -> None:
        self.name, self._alpha_m, self._alpha_f = name, alpha_m, alpha_f
        self.shift = alpha_m - alpha_f
        self._gamma = 0.5 - self.shift
        self._beta = (1 - self.shift) ** 2 / 4
        self.num_steps = 2 if self.shift else 1
        # With algorithmic damping the work of a mean force is not the energy that it gives.
        self.has_mean_forces = not self.shift
        self.uses_old_forces = alpha_f > 0
        # Newmark's forces are in balance at both ends: their work is that of the trapezoidal rule.
        self.end_weight = 1 - alpha_f if alpha_f else 0.5

    @classmethod
    def of_radius(cls, rho: float) -> GeneralizedAlpha:
        """Return the method with spectral radius rho at infinite frequency, 0 to 1."""
        check_number("time.rho_infinity", rho, 0.0, highest=1.0)
        return cls((2 * rho - 1) / (rho + 1), rho / (rho + 1))

    def formulas(self, h: float, state: MotionState) -> StepFormulas:
        """Return the formulas of a step (Newmark 1959 for velocity and acceleration)."""
        beta, gamma, a = self._beta, self._gamma, state.a
        if self.shift and state.before and state.before.size != h:
            before = state.before
            a = a + self.shift * (h / before.size - 1) * (a - before.a)
        rate = 1 / (beta * h**2)
        origin = state.u + h * state.v + h**2 * (0.5 - beta) * a
        velocity_rate = gamma * h * rate
        velocity_origin = origin - (state.v + h * (1 - gamma) * a) / velocity_rate
        error = h**2 * (beta + self.shift / 2 - 1 / 6)
        weight = 1 - self._alpha_f
        return StepFormulas(
            Affine(velocity_rate, velocity_origin),
            Affine(rate, origin),
            a,
            (error, -error),
            ((1 - self._alpha_m) / weight, self._alpha_m / weight),
            self._alpha_f / weight,
            gamma,
        )


def create(name: str, rho_infinity: float | None = None) -> Integrator:
    """Return the integrator with this name.

    Parameters
    ----------
    name : str
        One of `fem_snh.choices.INTEGRATORS`. ``semi_implicit`` has backward Euler's formulas; its
        solver makes one linearised step.
    rho_infinity : float, optional
        Spectral radius of ``generalized_alpha`` at infinite frequency, 0 to 1; default 0.8.

    Raises
    ------
    BadInput
        For an unknown name, a radius out of range or of another integrator.
    """
    choose("time.integrator", name, INTEGRATORS)
    if rho_infinity is not None and name != "generalized_alpha":
        accepted = "no value, as the integrator is not generalized_alpha"
        raise bad_value("time.rho_infinity", rho_infinity, accepted)
    if name == "newmark":
        return GeneralizedAlpha(0.0, 0.0, name)
    if name == "generalized_alpha":
        rho = DEFAULT_RHO_INFINITY if rho_infinity is None else rho_infinity
        return GeneralizedAlpha.of_radius(rho)
    return BDF2() if name == "bdf2" else BackwardEuler(name)
