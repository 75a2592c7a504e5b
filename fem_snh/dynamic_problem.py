"""Motion of a body in time in a dolfinx program: `DynamicProblem`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from fem_snh.arrays import Array
from fem_snh.choices import DEFAULT_INTEGRATOR, MASSES
from fem_snh.errors import BadInput, bad_value, check_number, on_every
from fem_snh.kernels.material import Material
from fem_snh.nonlinear_problem import PREDICTORS, NonlinearProblem
from fem_snh.problem.definition import DENSITIES, check_materials
from fem_snh.steps.dynamics.dynamics import Dynamics
from fem_snh.steps.stepping import Stepper

#: A function that returns velocities [m/s] (n, components) at reference coordinates [m] (n, 3).
Velocity = Callable[[Array], Array]

#: A step may be this many times longer or shorter than the duration: its size is a difference of
#: two loads in double precision, and formulas divide by its square.
_EXTREME = 1e12


class DynamicProblem(NonlinearProblem):
    """Integrate the motion of materials and UFL terms in time. Collective.

    Each step is a minimisation problem (docs/theory/dynamics.md), which the solver of
    `fem_snh.nonlinear_problem.NonlinearProblem` solves. The load parameter is time / duration.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m] in a Lagrange space. Its values are the displacement at time 0.
    materials : mapping of Material to ufl.Measure
        The cells that each material fills. Every cell must have a material.
    densities : mapping of Material to float
        Mass per reference volume [kg/m^3] of each material.
    integrator : str, optional
        One of `fem_snh.choices.INTEGRATORS`.
    duration : float
        The time [s] at which `steps` ends. Velocities of boundary values at the start are finite
        differences over 1/2000 of it.
    set_time : callable, optional
        ``set_time(t)`` sets constants, functions and boundary values of ``terms`` and ``bcs`` for a
        time [s]. Times come in any order, as velocities of boundary values are finite differences.
    mass : {"consistent", "lumped"}, optional
        The mass matrix.
    damping : tuple of float, optional
        Rayleigh damping: the factors of the mass [1/s] and of the stiffness [s].
    rho_infinity : float, optional
        Spectral radius of ``generalized_alpha`` at infinite frequency, 0 to 1.
    **arguments
        As for `fem_snh.nonlinear_problem.NonlinearProblem`: ``bcs``, ``terms``, ``hessian``, ...

    Attributes
    ----------
    time : float
        The present time [s].
    v, a : dolfinx Function
        Velocity [m/s] and acceleration [m/s^2] at the present time.
    dynamics : Dynamics
        Energies, errors and history of the motion.

    Raises
    ------
    BadInput
        On every rank, for arguments that contradict each other, and for a missing density.

    Examples
    --------
    >>> problem = fem_snh.DynamicProblem(u, {m: ufl.dx}, {m: 1000.0}, duration=2.0, bcs=bcs)
    >>> problem.start()
    >>> while problem.time < 2.0:
    ...     assert problem.step(0.01)
    """

    def __init__(
        self,
        u: Any,
        materials: Mapping[Material, Any],
        densities: Mapping[Material, float],
        integrator: str = DEFAULT_INTEGRATOR,
        *,
        duration: float,
        set_time: Callable[[float], None] | None = None,
        mass: str = MASSES[0],
        damping: tuple[float, float] = (0.0, 0.0),
        rho_infinity: float | None = None,
        **arguments: Any,
    ) -> None:
        check_materials(materials, arguments.get("mesh"))
        if not materials:
            raise bad_value("materials", {}, "a material: inertia needs its density")
        if densities is None:
            raise bad_value("densities", densities, DENSITIES)
        if set_time is not None and not callable(set_time):
            raise bad_value("set_time", set_time, "a function of the time [s]")
        self._integrator = integrator
        self._create_motion = partial(
            Dynamics,
            integrator=integrator,
            duration=duration,
            mass=mass,
            damping=damping,
            rho_infinity=rho_infinity,
        )
        self._duration, self._set_time, self._has_started = duration, set_time, False
        self._velocity: Velocity | None = None
        super().__init__(u, materials, densities=densities, **arguments)
        motion = self._steps[PREDICTORS[self._predictor]].motion
        assert motion is not None
        self.dynamics = motion
        self.v, self.a = self.dynamics.v, self.dynamics.a

    @property
    def time(self) -> float:
        """The present time [s]."""
        return self._problem.load * self._duration

    def state(self) -> dict[str, Array]:
        """Return the state from which `start` continues the motion. Collective.

        Another `DynamicProblem` with the same arguments and mesh partition can continue from it. If
        the motion has not begun, `start` begins it.

        Returns
        -------
        dict
            Copies of this rank's arrays, to be saved in one file per rank, as by ``numpy.savez``:
            "time" [s]; "unknowns", the owned part of `x`; "motion" (owned nodes, k), velocity,
            acceleration and what the integrator keeps; "about", JSON text on "motion"; and
            "NAME_history" of each term NAME with a history.
        """
        if not self._has_started:
            self.start()
        values, about = self.dynamics.history()
        terms = self._problem.history.by_name.items()
        return {
            "time": np.array(self.time),
            "unknowns": self.x.array.copy(),
            "motion": values,
            "about": np.array(json.dumps(about)),
            **{f"{name}_history": term.history()[1] for name, term in terms},
        }

    def start(
        self, velocity: Velocity | None = None, state: Mapping[str, Any] | None = None
    ) -> None:
        """Begin the motion at time 0 from the values of ``u``, or at a stored state. Collective.

        Parameters
        ----------
        velocity : callable, optional
            Initial velocities [m/s] (n, components) at reference coordinates [m] (n, 3).
            Default: zero.
        state : mapping, optional
            What `state` returned on this rank. The motion continues at the time of ``state``, as
            without an interruption; ``velocity`` must be None.

        Raises
        ------
        BadInput
            On every rank, if ``velocity`` does not return finite numbers of this shape, or for a
            state of another problem.
        """
        if state is not None:
            self._restore(state, velocity)
            return
        if velocity is not None and not callable(velocity):
            raise bad_value("velocity", velocity, "a function of coordinates (n, 3)")
        self._path = None
        self._read_displacement()
        self.dynamics.start(self._problem, velocity)
        self._has_started, self._velocity = True, velocity
        self._is_new = self._is_new or not self._problem.history.is_kept(self._problem.comm)
        self._write_solution()

    def _restore(self, state: Mapping[str, Any], velocity: Velocity | None) -> None:
        """Set unknowns, time, motion and histories of terms to a stored state. Collective."""
        if velocity is not None:
            raise bad_value("velocity", velocity, "no value, as 'state' has the velocities")
        problem, terms = self._problem, self._problem.history.by_name
        on_every(problem.comm, _check_state, state, terms, len(self.x.array))
        about = json.loads(str(state["about"]))
        self.x.array[:] = state["unknowns"]
        problem.set_load(float(state["time"]) / self._duration)
        for name, term in terms.items():
            term.set_history(np.asarray(state[f"{name}_history"]))
        problem.history.begin_step(problem.split(self.x)[0])
        self.dynamics.set_history(problem, np.asarray(state["motion"]), about)
        self._path, self._has_started, self._is_new = None, True, False
        self._write_solution()

    def step(self, size: float) -> bool:
        """Advance by one time step of ``size`` [s]; return whether it converged. Collective.

        If not, the state is unchanged, `reason` says why, and a shorter step can be tried. The
        first step calls `start` if the program did not.

        Raises
        ------
        BadInput
            On every rank, for a size outside of 1e-12 to 1e12 times ``duration``, or too small to
            change the time in double precision.
        """
        check_number("size", size, self._duration / _EXTREME, highest=self._duration * _EXTREME)
        if not self._has_started:
            self.start()
        to = self._problem.load + size / self._duration
        if not self._problem.load < to:
            raise bad_value("size", size, f"a step that double precision can add to {self.time:g}")
        with self._given.active():
            stepper = Stepper(self._steps[PREDICTORS[self._predictor]], 1)
            self._end(stepper.attempt(self._problem.load, to))
        if self.row["converged"]:  # else nothing has changed
            self._path, self._is_new = None, False
        self._write_solution()
        return bool(self.row["converged"])

    def steps(
        self, number: int, set_load: Callable[[float], None] | None = None
    ) -> Iterator[dict[str, Any]]:
        """Advance from the present time to ``duration``. Collective.

        A step that fails is halved, down to 1/64 of the nominal step, as in a run of a scene.
        `estimate_error` can repeat these steps if the motion began with them.

        Parameters
        ----------
        number : int
            Number of equal steps into which the whole duration is divided.
        set_load : None
            Must be None: the argument ``set_time`` of the class sets what changes in time.

        Yields
        ------
        dict
            The row of an attempted step, as in run.json: ``time``, ``converged``, ``reason``,
            ``newton``, ``linear``, ``energy``, ...
        """
        if set_load is not None:
            raise bad_value("set_load", set_load, "None: 'set_time' sets what changes in time")
        stepper = self._stepper(number)
        if not self._has_started:
            self.start()
        self._path = self._path_of(stepper, velocity=self._velocity) if self._is_new else None
        self._is_new = False
        yield from self._rows(stepper)

    def energies(self) -> dict[str, Any]:
        """Return present energies and momenta: the dict of `Dynamics.energies`. Collective."""
        return self.dynamics.energies(self._problem)

    def _in_time(self) -> dict[str, Any]:
        set_time, duration = self._set_time, self._duration
        if set_time is not None:
            self._load.function = lambda load: set_time(load * duration)
        return {
            "on_load": self._load if set_time else None,
            "motion": self._create_motion,
            "integrator": self._integrator,
            "duration": duration,
        }


def _check_state(state: Mapping[str, Any], terms: Iterable[str], size: int) -> None:
    """Raise BadInput unless a state has all keys and ``size`` unknowns. Not collective.

    ``terms`` are the names of the terms with a history.
    """
    for name in ("time", "unknowns", "motion", "about", *(f"{term}_history" for term in terms)):
        if name not in state:
            raise BadInput(f"state without {name!r}: expected what DynamicProblem.state returns")
    if (rows := len(state["unknowns"])) != size:
        accepted = f"{size}, as on the mesh and the ranks of this problem"
        raise bad_value("rows of state['unknowns']", rows, accepted)
