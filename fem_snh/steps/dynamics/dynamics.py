r"""The motion of a body in time: state, steps, errors, energies and momenta.

A time integrator (`fem_snh.steps.dynamics.integrators`) makes each step an incremental potential.
Inertia and damping are terms of the problem, and the solver is that of statics.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf, sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.kinematics import Kinematics
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.assembly.regions import Region
from fem_snh.assembly.unknowns import local_values, with_ghosts, writable_values
from fem_snh.choices import MASSES
from fem_snh.errors import BadInput, bad_value, check_number, on_every
from fem_snh.problem.problem import Problem
from fem_snh.steps.dynamics.force_balance import ForceBalance, MeanForces, mean_force_terms
from fem_snh.steps.dynamics.integrators import Affine, Before, MotionState, StepFormulas, create
from fem_snh.steps.dynamics.prescribed import PrescribedMotion
from fem_snh.terms.term import Term, WorkingTerm

if TYPE_CHECKING:
    from fem_snh.terms.rigid_parts import RigidParts

#: Load interval over which prescribed motions are differenced at the start: their rounding errors
#: are then far below the tolerance of forces.
_START = 5e-4
#: Names of the fields of `Before` in a checkpoint.
_BEFORE = ("u_before", "v_before", "a_before")


class _Step(NamedTuple):
    """The step between `begin_step` and `end_step`: size [s], load and state at the start."""

    size: float
    load: float
    state: MotionState
    formulas: StepFormulas


class Dynamics:
    """Inertia and damping of a body, and its motion from step to step. Collective.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m].
    regions : sequence of Region
        The materials with their densities.
    dirichlet : Dirichlet
        The constrained dofs and their values.
    kinematics : Kinematics
        The kinematics of the displacement.
    integrator : str
        One of `fem_snh.choices.INTEGRATORS`.
    mass : {"consistent", "lumped"}, optional
        The mass matrix: see `NodalMass`.
    damping : tuple of float, optional
        Rayleigh damping: the factors of the mass [1/s] and of the stiffness [s].
    rho_infinity : float, optional
        Spectral radius of ``generalized_alpha`` at infinite frequency, 0 to 1.
    duration : float
        The time [s] in which the load goes from 0 to 1.
    tolerance : float, optional
        Largest local error of a step, relative to V^(1/3), by which the size of steps is chosen.
        Default: equal steps.

    Attributes
    ----------
    terms : list of Term
        Inertia and, with ``damping``, damping: terms for the problem.
    integrator : Integrator
        The time integrator.
    mass : NodalMass
        The mass matrix.
    v, a : dolfinx Function
        Velocity [m/s] and acceleration [m/s^2] at the end of the last accepted step.
    dissipated, work : float
        The entries "dissipated" and "work" of `energies` [J].

    Raises
    ------
    BadInput
        On every rank, for a bad value or a material without a density.
    """

    def __init__(
        self,
        u: _dolfinx.Function,
        regions: Sequence[Region],
        dirichlet: Dirichlet,
        kinematics: Kinematics,
        integrator: str,
        *,
        mass: str = MASSES[0],
        damping: tuple[float, float] = (0.0, 0.0),
        rho_infinity: float | None = None,
        duration: float,
        tolerance: float | None = None,
    ) -> None:
        if not isinstance(damping, Sequence) or isinstance(damping, str) or len(damping) != 2:
            raise bad_value("time.damping", damping, "two numbers: of the mass, of the stiffness")
        for key, value in zip(("mass", "stiffness"), damping, strict=True):
            check_number(f"time.damping.{key}", value, 0.0)
        check_number("time.duration", duration, 0.0, exclusive=True)
        self.integrator = create(integrator, rho_infinity)
        self.duration, self.tolerance = duration, tolerance
        V, self._kinematics = u.function_space, kinematics
        self.mass = NodalMass(V, regions, mass, kinematics)
        self.v, self.a = _dolfinx.function(V, "velocity"), _dolfinx.function(V, "acceleration")
        self._motion = PrescribedMotion(V, dirichlet, duration)
        self._balance = ForceBalance(V, self.mass, damping)
        self.terms = self._balance.terms
        self.dissipated = self.work = 0.0
        self._first_energy: float | None = None
        self._before: Before | None = None
        self._rigid: RigidParts | None = None
        #: The part of ``a`` by forces that a step has as means over it, (local dofs,), or None.
        self._by_means: Array | None = None
        self._step: _Step  # set by begin_step
        #: Damping forces, and all forces but inertia and means, at the last state (owned dofs,).
        self._damping: Array
        self._forces: Array

    def start(self, problem: Problem, velocity: Callable[[Array], Array] | None = None) -> None:
        """Begin at load 0 with a velocity, and the acceleration that balances forces. Collective.

        Parameters
        ----------
        problem : Problem
            The problem at its initial displacement, with the terms of this object.
        velocity : callable, optional
            Velocities [m/s] (n, components) of nodes with reference coordinates [m] (n, 3).
            Default: zero. Constrained dofs get their prescribed velocity.

        Raises
        ------
        BadInput
            On every rank, if the velocities have another shape, or are not finite.
        """
        problem.set_load(0.0)
        problem.prescribe(problem.x)
        problem.history.begin_step(problem.split(problem.x)[0])
        self.dissipated = self.work = 0.0
        self._first_energy = self._before = None
        self._rigid = problem.rigid
        self._motion.add_parts(problem.rigid)
        motion = self._motion.at(problem.load, -_START, problem.load)
        v = self.v.x.array
        v[:] = 0.0
        if velocity is not None:
            nodes = problem.V.tabulate_dof_coordinates()
            columns = self._kinematics.components
            v[:] = on_every(problem.comm, _values, velocity, nodes, columns).ravel()
        self._motion.project(v)
        v += motion.v
        if self._rigid:
            turning = self._rigid.make_rigid(problem.x, self.mass, -_START, v)
            motion.a[self._rigid.dofs] = turning
            motion.a[:] = with_ghosts(problem.V, motion.a[: self.mass.num_owned])
        balance = self._balance
        balance.update_stiffness(problem, v, 0.0)
        self._damping = balance.damping_forces(v) + balance.start_volume_damping(v)
        self._forces = balance.other_forces(problem) + self._damping
        self.a.x.array[:] = balance.acceleration(problem, self._forces, motion.a)
        self._by_means = None
        if means := self._mean_forces(problem, None):
            self._by_means = means.acceleration
            self._forces = self._forces - means.forces
        balance.set_motion(self.a.x.array, self._damping)
        if problem.has_energy:
            self._first_energy = total_energy(self.energies(problem))

    def begin_step(self, problem: Problem, load: float) -> tuple[float, float]:
        """Set the formulas of the step from the problem's state to a load. Collective.

        If the step fails, restore the problem's state; then call this method again to repeat the
        step, or `cancel_step`.

        Returns
        -------
        largest : float
            The largest 2-norm of external or inertial forces at the step's start [N].
        least : float
            The smallest 2-norm, not 0, of a dead load [N]; inf without one.
        """
        norms = self._force_norms(problem)
        h = (load - problem.load) * self.duration
        u = np.array(local_values(problem.split(problem.x)[0]))
        state = MotionState(u, self.v.x.array.copy(), self._smooth_acceleration(), self._before)
        formulas = self.integrator.formulas(h, state)
        project = self._motion.project
        motion = self._motion.after(state, load, problem.load)
        formulas.velocity.set_values(project, motion.u, motion.v)
        formulas.acceleration.set_values(project, motion.u, motion.a)
        self._step = _Step(h, problem.load, state, formulas)
        balance = self._balance
        balance.update_stiffness(problem, state.v, formulas.tangent * h)
        new, old = formulas.inertia
        rate, origin = formulas.acceleration.rate, formulas.acceleration.origin
        inertia = Affine(new * rate, origin - old / (new * rate) * formulas.old_acceleration)
        inertia.set_values(project, motion.u, motion.a + formulas.old_forces * state.a)
        constant = formulas.old_forces * self._old_forces() if formulas.old_forces else None
        balance.set_step(inertia, formulas.velocity, constant)
        balance.begin_volume_damping(problem, formulas.velocity)
        if self.integrator.has_mean_forces:
            balance.weight_mean_forces(problem, new / formulas.gamma)
        return norms

    def _force_norms(self, problem: Problem) -> tuple[float, float]:
        """Return the two norms of forces [N] that `begin_step` returns. Collective."""
        forces, loads = problem.x.duplicate(), _loads(problem, self.terms)
        problem.gradient(problem.x, forces, loads)
        inertial = self._balance.inertial_forces(self.a.x.array)
        largest = max(forces.norm(), sqrt(problem.comm.allreduce(float(inertial @ inertial))))
        if problem.rigid:
            largest = max(largest, *problem.rigid.force_norms(problem.x))
        least = inf
        for term in loads:
            if not term.has_hessian:
                problem.gradient(problem.x, forces, [term])
                least = min(least, forces.norm() or inf)
        return largest, least

    def extrapolate(self, x: PETSc.Vec, load: float) -> None:
        """Move the displacement in ``x`` to a load with the velocity of the step's start, in place.

        The acceleration is left out: its stiff modes are noise over a long time step.
        """
        v = self.v.x.array[: self.mass.num_owned]
        x.array[: len(v)] += (load - self._step.load) * self.duration * v

    def cancel_step(self, problem: Problem) -> None:
        """End a failed step after the problem's state is restored to its start. Collective."""
        self._balance.weight_mean_forces(problem, None)
        self._balance.end_volume_damping(problem, accepted=False)
        self._set_motion()

    def end_step(self, problem: Problem) -> None:
        """Accept the solved step: update motion, work and dissipation. Collective.

        Call it before `TermHistory.end_step`.
        """
        h, load, state, formulas = self._step
        u = np.array(local_values(problem.split(problem.x)[0]))
        v, a = formulas.velocity(u), formulas.acceleration(u)
        if means := self._mean_forces(problem):
            a -= means.acceleration / formulas.gamma
        if self._rigid and not self.integrator.shift:  # else they are of other times than the pose
            self._rigid.make_rigid(problem.x, self.mass, problem.load - load, v, a)
        weight, moved = self.integrator.end_weight, (u - state.u)[: self.mass.num_owned]
        balance, damping = self._balance, self._balance.damping_forces(v)
        damping += balance.end_volume_damping(problem)
        if balance.damping:
            mean = weight * damping + (1 - weight) * self._damping
            self.dissipated += problem.comm.allreduce(float(mean @ moved))
        work, lost = work_of_loads(problem, state.u, load, weight, self.terms)
        self.work, self.dissipated = self.work + work, self.dissipated + lost
        if self._needs_forces:
            others = balance.smooth_forces if means else balance.other_forces
            forces = others(problem) + damping
            if self._moves:
                old = self._acceleration(state.a, state.before and state.before.a)
                new = self._acceleration(a, formulas.old_acceleration)
                mean = weight * (forces + balance.inertial_forces(new))
                mean += (1 - weight) * (self._forces + balance.inertial_forces(old))
                if means:
                    mean += means.forces + balance.inertial_forces(means.acceleration)
                work = problem.dirichlet.work(mean, moved)
                if self._rigid:
                    of_parts = self._rigid.dofs
                    work += float(np.sum(mean[of_parts] * moved[of_parts]))
                self.work += problem.comm.allreduce(work)
            self._forces = forces
        self._damping = damping
        self.v.x.array[:], self.a.x.array[:] = v, a
        self._by_means = None
        if present := self._mean_forces(problem, None):
            self._by_means = present.acceleration
            self.a.x.array[:] += present.acceleration
        self._before = Before(h, state.u, state.v, formulas.old_acceleration)
        self._set_motion()

    def local_error(self, problem: Problem) -> float:
        """Return an estimate of the solved step's local error, before `end_step`. Collective.

        It is the root mean square of the displacement's error, weighted by mass, over V^(1/3)
        (docs/theory/dynamics.md).
        """
        formulas = self._step.formulas
        new, old = formulas.error
        u = np.array(local_values(problem.split(problem.x)[0]))
        error = new * formulas.acceleration(u) + old * formulas.old_acceleration
        if self._by_means is not None:
            new_forces, means = (self._mean_forces(problem, weight) for weight in (None, 1.0))
            assert new_forces and means
            by_means = new_forces.acceleration - means.acceleration / formulas.gamma
            error += new * by_means + old * self._by_means
        self._motion.project(error)
        return float(np.sqrt(self.mass.dot(error, error) / self.mass.total)) / problem.length

    def energies(self, problem: Problem) -> dict[str, Any]:
        """Return energies and momenta of the present state. Collective.

        Returns
        -------
        dict
            The entries of `motion_measures`; "energy" [J], the sum of its energies (None if a
            material has none); and since the start, in [J], "work" of prescribed motion, moving
            obstacles and changing loads, "dissipated" by damping and friction, and unless a force
            has no energy, "numerical_dissipation", what else the integrator lost.
        """
        found = motion_measures(problem, self.mass, self.v.x.array, self.terms)
        energy = None if found["elastic"] is None else total_energy(found)
        found = {"energy": energy, **found, "work": self.work, "dissipated": self.dissipated}
        if problem.has_energy and self._first_energy is not None:
            available = self._first_energy + self.work - self.dissipated
            found["numerical_dissipation"] = available - total_energy(found)
        return found

    def row(self, problem: Problem, load: float, before: float) -> dict[str, Any]:
        """Return the entries of a step's row: "time", "time_step" [s], and `energies`. Collective.

        The step is from load ``before`` to ``load``.
        """
        times = {"time": load * self.duration, "time_step": (load - before) * self.duration}
        return times | self.energies(problem)

    def _old_forces(self) -> Array:
        """Return the forces [N] of the step's start in its balance, (owned dofs,). Collective.

        On nodes of rigid parts, constraint forces of the parts are included: they rotate, so forces
        balance at each end of the step, but their mean does not (Arnold & Brüls 2007).
        """
        if not self._rigid:
            return self._forces
        a = self._acceleration(self._smooth_acceleration(), self._before and self._before.a)
        forces, dofs = self._forces.copy(), self._rigid.dofs
        forces[dofs] = -self._balance.inertial_forces(a)[dofs]
        return forces

    def _mean_forces(self, problem: Problem, weight: float | None = 1.0) -> MeanForces | None:
        """Return `ForceBalance.mean_forces` if the integrator uses them, else None. Collective."""
        if not self.integrator.has_mean_forces:
            return None
        return self._balance.mean_forces(problem, weight)

    def _smooth_acceleration(self) -> Array:
        """Return a copy of the acceleration (local dofs,) without the part by mean forces."""
        a: Array = self.a.x.array.copy()
        return a if self._by_means is None else np.asarray(a - self._by_means)

    @property
    def _needs_forces(self) -> bool:
        """Whether a step needs the forces at its start, for its balance or work of reactions."""
        return self._moves or self.integrator.uses_old_forces

    @property
    def _moves(self) -> bool:
        """Whether a motion is prescribed."""
        return self._motion.moves or bool(self._rigid and self._rigid.moves)

    def history(self) -> tuple[Array, dict[str, Any]]:
        """Return what the next step needs of earlier steps, for a checkpoint.

        Returns
        -------
        values : (owned nodes, k)
            Copies of nodal fields side by side, each with the displacement's components.
        about : dict
            Numbers, and the names "fields" of the fields in ``values``; the same on all ranks.
        """
        about: dict[str, Any] = {"dissipated": self.dissipated, "work": self.work}
        if self._first_energy is not None:
            about["first_energy"] = self._first_energy
        fields = {"v": self.v.x.array, "a": self.a.x.array}
        if self._before and (self.integrator.num_steps > 1 or self._motion.by_hand):
            about["step_before"] = self._before.size
            fields |= dict(zip(_BEFORE, self._before[1:], strict=True))
        if self._by_means is not None:
            fields["by_means"] = self._by_means
        if self._balance.damping:
            fields["damping"] = self._damping
        if self._needs_forces:
            fields["forces"] = self._forces
        columns = self._kinematics.components
        owned = [field[: self.mass.num_owned].reshape(-1, columns) for field in fields.values()]
        return np.concatenate(owned, axis=1), about | {"fields": list(fields)}

    def set_history(self, problem: Problem, values: Array, about: Mapping[str, Any]) -> None:
        """Continue from what `history` returned, instead of `start`. Collective.

        Raises
        ------
        BadInput
            If a field that the integrator needs is missing, as in an older checkpoint.
        """
        self._rigid = problem.rigid
        self._motion.add_parts(problem.rigid)
        V, fields = self.v.function_space, {}
        columns = np.hsplit(values, values.shape[1] // self._kinematics.components)
        for name, field in zip(about.get("fields", ()), columns):
            fields[name] = with_ghosts(V, field.ravel())
        means = self.integrator.has_mean_forces and bool(mean_force_terms(problem))
        optional = {"damping": self._balance.damping, "forces": self._needs_forces}
        optional["by_means"] = means
        if not {"v", "a", *(name for name, needed in optional.items() if needed)} <= set(fields):
            raise BadInput("the checkpoint is of an older version: start again with --overwrite")
        self.v.x.array[:], self.a.x.array[:] = fields["v"], fields["a"]
        self.dissipated, self.work = about["dissipated"], about["work"]
        self._first_energy = about.get("first_energy")
        self._before, self._by_means = None, fields.get("by_means")
        if "u_before" in fields:
            self._before = Before(about["step_before"], *(fields[name] for name in _BEFORE))
        none, owned = np.zeros(self.mass.num_owned), slice(self.mass.num_owned)
        self._damping = fields.get("damping", none)[owned]
        self._forces = fields.get("forces", none)[owned]
        self._set_motion()

    def _set_motion(self) -> None:
        """Set inertia and damping so that the gradient has all present forces. Collective."""
        a = self._acceleration(self._smooth_acceleration(), self._before and self._before.a)
        if self._by_means is not None:
            a = a + self._by_means
        self._balance.set_motion(a, self._damping)

    def _acceleration(self, a: Array, before: Array | None) -> Array:
        """Return the acceleration at a step's end, to second order, (local dofs,) [m/s^2].

        Parameters
        ----------
        a : (local dofs,)
            The integrator's acceleration in the step, which may belong to a shifted time.
        before : (local dofs,) or None
            The integrator's acceleration in the step before.
        """
        shift = self.integrator.shift
        if not shift or before is None:
            return a
        # Constrained dofs keep the acceleration of the prescribed motion.
        change = shift * (a - before)
        self._motion.project(change)
        return np.asarray(a - change)


def _values(velocity: Callable[[Array], Array], nodes: Array, columns: int) -> Array:
    """Return ``velocity(nodes)``; raise BadInput unless it is (n, columns) and finite."""
    found = np.asarray(velocity(nodes))
    if found.shape != (len(nodes), columns):
        accepted = f"an array {(len(nodes), columns)}"
        raise bad_value("velocity", f"an array {found.shape}", accepted)
    if found.dtype.kind not in "fiu" or not np.isfinite(found).all():
        raise bad_value("velocity", found, "finite numbers")
    return found


def motion_measures(
    problem: Problem, mass: NodalMass, v: Array, excluded: Sequence[Term]
) -> dict[str, Any]:
    """Return energies and momenta of a problem's present state. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    mass : NodalMass
        The mass matrix.
    v : (local dofs,)
        The velocity [m/s], with ghosts.
    excluded : sequence of Term
        Terms whose energy is no part of the potential energy: those of the time integrator.

    Returns
    -------
    dict
        "kinetic", "elastic" (None for a material without an energy) and "potential" (the sum of all
        other terms that have an energy) [J]; "momentum" [kg m/s] and "angular_momentum" about the
        origin [kg m^2/s], lists of three components. In a plane all are per thickness; of a body of
        revolution only the axial components are not zero.
    """
    u, p = problem.split(problem.x)
    kinematics = problem.kinematics
    momenta = kinematics.padded(mass.apply(v))
    x = problem.V.tabulate_dof_coordinates() + kinematics.padded(local_values(u))
    local = np.array([kinematics.total(vectors) for vectors in (momenta, np.cross(x, momenta))])
    momentum, angular_momentum = problem.comm.allreduce(local)
    loads = [t for t in _loads(problem, excluded) if t.has_energy]
    return {
        "kinetic": mass.dot(v, v) / 2,
        "elastic": problem.elastic.energy(u, p) if problem.elastic.has_energy else None,
        "potential": sum(term.energy(u, p) for term in loads),
        "momentum": momentum.tolist(),
        "angular_momentum": angular_momentum.tolist(),
    }


def total_energy(measures: Mapping[str, Any]) -> float:
    """Return the sum of kinetic, elastic and potential energy [J]."""
    return float(sum(measures[name] for name in ("kinetic", "elastic", "potential")))


def work_of_loads(
    problem: Problem, u: Array, load: float, end_weight: float, excluded: Sequence[Term]
) -> tuple[float, float]:
    r"""Return the work of changing loads in a step, and the energy dissipated [J]. Collective.

    With E(u, t) the energy of the terms that depend on the load, and s = ``end_weight``,

    .. math:: s [E(u_0, t_1) - E(u_0, t_0)] + (1 - s) [E(u_1, t_1) - E(u_1, t_0)] .

    A `WorkingTerm` measures its work and dissipation itself: with a stiff moving obstacle and a
    body at rest, this formula is far above the work of the obstacle's forces.

    Parameters
    ----------
    problem : Problem
        The problem at the step's end.
    u : (local dofs,)
        Displacement [m] at the step's start.
    load : float
        Load at the step's start.
    end_weight : float
        Weight of the forces at the step's end in the work that they do.
    excluded : sequence of Term
        As for `motion_measures`.
    """
    loads = [t for t in _loads(problem, excluded) if t.has_energy and t.depends_on_load]
    loads = [t for t in loads if not isinstance(t, WorkingTerm)]
    work, dissipated = problem.history.step_work(problem.split(problem.x)[0], end_weight)
    if not loads:
        return work, dissipated
    before, (after, p) = _dolfinx.create_vector(problem.V), problem.split(problem.x)
    writable_values(before)[:] = u
    for sign, at in ((1, problem.load), (-1, load)):
        problem.dirichlet.set_load(at)  # a program's constants
        for term in loads:
            term.set_load(at)
            work += sign * end_weight * term.energy(before, p)
            if end_weight < 1:
                work += sign * (1 - end_weight) * term.energy(after, p)
    problem.dirichlet.set_load(problem.load)
    for term in loads:
        term.set_load(problem.load)
    return work, dissipated


def _loads(problem: Problem, excluded: Sequence[Term]) -> list[Term]:
    """Return the problem's terms without the elastic energy and the excluded terms."""
    return [t for t in problem.terms if t is not problem.elastic and t not in excluded]
