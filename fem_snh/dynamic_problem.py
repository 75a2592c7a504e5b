"""Motion in time of a displacement in a dolfinx program."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.choices import DEFAULT_INTEGRATOR, MASSES
from fem_snh.errors import BadInput, bad_value, check_number, on_every
from fem_snh.kernels.material import Material
from fem_snh.nonlinear_problem import PREDICTORS, NonlinearProblem
from fem_snh.problem.definition import DENSITIES, check_materials
from fem_snh.steps.dynamics.dynamics import Dynamics
from fem_snh.steps.stepping import Stepper

Array = npt.NDArray[np.float64]
#: Velocities [m/s] (n, components) at reference coordinates [m] (n, 3).
Velocity = Callable[[Array], Array]

#: Largest ratio of a step and the duration, and its inverse the smallest: a step is the difference
#: of two loads in double precision, and its square divides.
_EXTREME = 1e12


class DynamicProblem(NonlinearProblem):
    """Integrate the motion of materials and UFL terms in time. Collective.

    Each step is a minimisation problem (docs/theory/dynamics.md), solved as that of
    `fem_snh.nonlinear_problem.NonlinearProblem`.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m] in a Lagrange space, with its values at time 0.
    materials : mapping of Material to ufl.Measure
        The cells that each material fills; all cells have one.
    densities : mapping of Material to float
        Mass per reference volume [kg/m^3] of each material.
    integrator : str, optional
        One of `fem_snh.choices.INTEGRATORS`.
    duration : float
        A time [s] in which the motion is seen: prescribed velocities at the start are differences
        over 1/2000 of it.
    set_time : callable, optional
        ``set_time(t)`` sets constants, functions and boundary values of ``terms`` and ``bcs`` for a
        time [s]. Times are not in order: prescribed velocities and accelerations are differences.
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
        The time of ``u`` [s].
    v, a : dolfinx Function
        Velocity [m/s] and acceleration [m/s^2].
    dynamics : Dynamics
        Energies, errors and history of the motion.

    Raises
    ------
    BadInput
        On every rank, for input that does not fit together, and for a missing density.

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
        """The time of ``u`` [s]."""
        return self._problem.load * self._duration

    def state(self) -> dict[str, Array]:
        """Return what a problem like this needs to continue at the present time. Collective.

        Returns
        -------
        dict
            Arrays of this rank, as ``numpy.savez`` stores them. `start` accepts them on the same
            mesh and number of ranks.
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
        """Begin at time 0 with the present values of ``u``, or at a stored state. Collective.

        Parameters
        ----------
        velocity : callable, optional
            Initial velocities [m/s] (n, components) at reference coordinates [m] (n, 3).
            Default: zero.
        state : mapping, optional
            What `state` returned: the motion continues at its time, as without an interruption.

        Raises
        ------
        BadInput
            On every rank, if it does not return such velocities, or for a state of another problem.
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
        """Continue from what `state` returned. Collective."""
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
        """Advance by one time step [s]; return whether the solver converged. Collective.

        Otherwise nothing has changed, `reason` says why, and a shorter step can be tried. The first
        step calls `start` if the program did not.

        Raises
        ------
        BadInput
            On every rank, for a size that is no positive number or far from ``duration``.
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

        A step that fails is halved, down to 1/64 of the nominal one, as in a run of a scene.
        `estimate_error` follows these steps again, if they are the whole motion.

        Parameters
        ----------
        number : int
            Number of equal steps of the whole duration.
        set_load : None
            ``set_time`` sets what changes.

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
        """Return energies and momenta at the present time: see `Dynamics.energies`. Collective."""
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
    """Raise BadInput unless a state has the arrays of this rank, of so many unknowns.

    Not collective.
    """
    for name in ("time", "unknowns", "motion", "about", *(f"{term}_history" for term in terms)):
        if name not in state:
            raise BadInput(f"state without {name!r}: expected what DynamicProblem.state returns")
    if (rows := len(state["unknowns"])) != size:
        accepted = f"{size}, as on the mesh and the ranks of this problem"
        raise bad_value("rows of state['unknowns']", rows, accepted)
