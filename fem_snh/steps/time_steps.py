"""What steps in time have beside load steps: the motion, its error and its rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.kinematics import Kinematics
from fem_snh.assembly.regions import Region
from fem_snh.assembly.unknowns import add_ghosts, writable_values
from fem_snh.choices import MASSES
from fem_snh.problem.initial_state import initial_velocity
from fem_snh.problem.problem import Problem
from fem_snh.steps.stepping import AdaptiveStepSize, StepSize

if TYPE_CHECKING:
    from fem_snh.scenes import Start, Time
    from fem_snh.steps.dynamics.dynamics import Dynamics

Array = npt.NDArray[np.float64]


class TimeSteps:
    """The steps of a motion in time, as `StepSolver` makes them. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, which has the terms of ``dynamics``.
    dynamics : Dynamics
        The motion.
    duration : float
        The time [s] in which the load goes from 0 to 1.
    semi_implicit : bool
        Whether a step is one linearised step.
    tolerance : float, optional
        Largest error of a step, relative to the body's size V^(1/3); the steps are as long as it
        permits. Default: equal steps.
    """

    def __init__(
        self,
        problem: Problem,
        dynamics: Dynamics,
        duration: float,
        semi_implicit: bool,
        tolerance: float | None = None,
    ) -> None:
        self.dynamics, self.duration, self.semi_implicit = dynamics, duration, semi_implicit
        self.tolerance = tolerance
        self._problem = problem
        inner = [problem.elastic, *dynamics.terms]
        self._loads = [term for term in problem.terms if term not in inner]

    @property
    def functions(self) -> dict[str, Any]:
        """The fields of output, by the names of `fem_snh.records.output_fields.IN_TIME`."""
        return {"velocity": self.dynamics.v, "acceleration": self.dynamics.a}

    def start(self, velocity: Callable[[Array], Array] | None = None) -> None:
        """Begin at load 0 with the present displacement, which meets the boundary values there.

        Parameters
        ----------
        velocity : callable, optional
            The initial velocity: see `Dynamics.start`.
        """
        problem = self._problem
        problem.set_load(0.0)
        problem.prescribe(problem.x)
        problem.history.begin_step(problem.split(problem.x)[0])
        self.dynamics.start(problem, velocity)

    def step_size(self, steps: int) -> StepSize:
        """Return the sizes of the time steps, of which ``steps`` nominal ones have the duration."""
        if self.tolerance is None:
            return StepSize(steps)
        return AdaptiveStepSize(steps, self.dynamics.integrator.order)

    def extrapolate(self, x: PETSc.Vec, load: float) -> None:
        """Move the displacement in ``x`` with its velocity, to the time of a load.

        The acceleration is left out: that of the stiff modes is noise on a long time step.
        """
        v = self.dynamics.v.x.array[: self.dynamics.mass.num_owned]
        x.array[: len(v)] += (load - self._before) * self.duration * v

    def begin_step(self, load: float) -> tuple[float, float]:
        """Begin a step from the problem's state to a load; return norms of forces there [N].

        The largest one of external and inertial forces, and the smallest one of a dead load.
        """
        problem = self._problem
        self._before = problem.load
        forces = problem.x.duplicate()
        problem.gradient(problem.x, forces, self._loads)
        largest = max(forces.norm(), self._inertial_force())
        if problem.rigid:
            largest = max(largest, *problem.rigid.force_norms(problem.x))
        least = inf
        for term in self._loads:
            if not term.has_hessian:
                problem.gradient(problem.x, forces, [term])
                least = min(least, forces.norm() or inf)
        self.dynamics.begin_step(problem, load)
        return largest, least

    def error(self) -> float:
        """Return the estimate of the solved step's error, relative to V^(1/3)."""
        return self.dynamics.local_error(self._problem) / self._problem.length

    def end_step(self) -> None:
        """Accept the step."""
        self.dynamics.end_step(self._problem)

    def cancel_step(self) -> None:
        """End a step that failed, with the state at its start."""
        self.dynamics.cancel_step(self._problem)

    def _inertial_force(self) -> float:
        """Return the norm of M a [N]."""
        force = _dolfinx.create_vector(self._problem.V)
        writable_values(force)[:] = self.dynamics.mass.apply(self.dynamics.a.x.array)
        add_ghosts(force)
        return float(force.norm())

    def row(self, load: float, before: float) -> dict[str, Any]:
        """Return what a step from load ``before`` to ``load`` adds to its row of run.json."""
        duration = self.duration
        return {
            "time": load * duration,
            "time_step": (load - before) * duration,
            **self.energies(),
        }

    def energies(self) -> dict[str, Any]:
        """Return energies and momenta; "energy" is the sum of those that the body has [J]."""
        energies = self.dynamics.energies(self._problem)
        parts = [energies[key] for key in ("kinetic", "elastic", "potential")]
        return {"energy": None if None in parts else sum(parts), **energies}


@dataclass(frozen=True)
class TimeIntegration:
    """How a body is integrated in time, in any element: the settings of `Dynamics` and `TimeSteps`.

    Attributes
    ----------
    integrator : str
        One of `fem_snh.choices.INTEGRATORS`.
    duration : float
        The time [s] in which the load goes from 0 to 1.
    mass, damping, rho_infinity
        As for `Dynamics`.
    tolerance : float or None
        As for `TimeSteps`.
    """

    integrator: str
    duration: float
    mass: str = MASSES[0]
    damping: tuple[float, float] = (0.0, 0.0)
    rho_infinity: float | None = None
    tolerance: float | None = None

    def create_dynamics(
        self,
        u: _dolfinx.Function,
        regions: Sequence[Region],
        dirichlet: Dirichlet,
        kinematics: Kinematics,
    ) -> Dynamics:
        """Return the motion of a body, whose terms its problem needs. Collective."""
        from fem_snh.steps.dynamics.dynamics import Dynamics

        return Dynamics(
            u,
            regions,
            dirichlet,
            kinematics,
            self.integrator,
            mass=self.mass,
            damping=self.damping,
            rho_infinity=self.rho_infinity,
            duration=self.duration,
        )

    def time_steps(self, problem: Problem) -> TimeSteps:
        """Return the steps of a problem that has the terms of its motion."""
        dynamics: Any = problem.motion
        semi_implicit = self.integrator == "semi_implicit"
        return TimeSteps(problem, dynamics, self.duration, semi_implicit, self.tolerance)


def time_integration(time: Time) -> TimeIntegration:
    """Return the time integration of a scene."""
    damping = (time.damping.mass, time.damping.stiffness)
    given = time.mass, damping, time.rho_infinity, time.tolerance
    return TimeIntegration(time.integrator, time.duration, *given)


def start_motion(problem: Problem, time: Time, start: Start | None) -> TimeSteps:
    """Return the steps of a scene in time, with its initial velocity set. Collective."""
    steps = time_integration(time).time_steps(problem)
    steps.start(initial_velocity(problem, start) if start else None)
    return steps
