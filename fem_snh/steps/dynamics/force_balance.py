"""The balance of inertia, damping and all other forces of a problem at one state.

The damping stiffness rotates with each cell: `cell_rotations` integrates the cells' spin.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh._petsc import vector_like
from fem_snh.arrays import Array
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.assembly.unknowns import local_values, owned_sums, update_ghosts, with_ghosts
from fem_snh.geometry.rotations import skew
from fem_snh.problem.problem import Problem
from fem_snh.steps.dynamics.integrators import Affine
from fem_snh.steps.dynamics.motion_terms import Inertia, RayleighDamping
from fem_snh.terms.term import MeanForceTerm, Term


class MeanForces(NamedTuple):
    """Forces that enter a step by their mean over it: see `fem_snh.terms.term.MeanForceTerm`.

    Attributes
    ----------
    forces : (owned dofs,)
        The gradient dE/du [N] of the terms.
    acceleration : (local dofs,)
        The acceleration [m/s^2] that balances ``forces`` alone.
    """

    forces: Array
    acceleration: Array


class ForceBalance:
    """The terms of inertia and damping, and the forces of all other terms.

    In a step the terms depend on the displacement at its end (`set_step`). Between steps they are
    the forces of the present motion (`set_motion`), so that the problem's gradient at constrained
    dofs is the force of the constraint.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mass : NodalMass
        The mass matrix.
    damping : tuple of float
        Rayleigh damping: the factors of the mass [1/s] and of the stiffness [s].

    Attributes
    ----------
    inertia : Inertia
    damping : RayleighDamping or None
        None if both factors are zero.
    """

    def __init__(
        self, V: _dolfinx.FunctionSpace, mass: NodalMass, damping: tuple[float, float]
    ) -> None:
        self._V, self._mass, self.inertia = V, mass, Inertia(mass)
        self.damping = RayleighDamping(mass, damping) if any(damping) else None
        self._pressure_damping: tuple[float, Any]  # ratio and origin of the pressure's viscous part

    @property
    def terms(self) -> list[Term]:
        """Inertia, and damping if there is any."""
        return [self.inertia, *([self.damping] if self.damping else [])]

    def set_step(self, acceleration: Affine, velocity: Affine, constant: Array | None) -> None:
        """Set acceleration and velocity of a step's end, and constant forces (owned dofs,) [N]."""
        self.inertia.acceleration, self.inertia.constant = acceleration, constant
        if self.damping:
            self.damping.velocity = velocity

    def set_motion(self, a: Array, damping: Array) -> None:
        """Set the forces of the present motion. Collective.

        Parameters
        ----------
        a : (local dofs,)
            The acceleration [m/s^2], with ghosts.
        damping : (owned dofs,)
            The damping forces [N].
        """
        self.inertia.acceleration = None
        self.inertia.constant = self.inertial_forces(a) + damping
        if self.damping:
            self.damping.velocity = None

    def update_stiffness(self, problem: Problem, v: Array, time: float) -> None:
        """Assemble the damping stiffness of the present state. Collective.

        Parameters
        ----------
        problem : Problem
            The problem, at the state.
        v : (local dofs,)
            The velocity [m/s] at the state.
        time : float
            Time [s] for which each cell's stiffness is rotated with the spin of ``v``.
        """
        if not (self.damping and self.damping.has_stiffness):
            return
        (u, p), rotations = problem.split(problem.x), None
        if time and v.any():
            kinematics, nodes = problem.kinematics, _dolfinx.node_dofs(problem.V)
            x = problem.V.tabulate_dof_coordinates() + kinematics.padded(local_values(u))
            motion = x[nodes], kinematics.padded(v)[nodes]
            rotations = cell_rotations(*motion, time, kinematics.revolved)
        self.damping.update_stiffness(
            problem.matrix,
            problem.x,
            u,
            lambda target: problem.elastic.add_hessian(u, p, "objective", target, rotations),
        )

    def damping_forces(self, v: Array) -> Array:
        """Return C v [N], (owned dofs,), of a velocity (local dofs,). Collective."""
        if not self.damping:
            return np.zeros(self._mass.num_owned)
        return owned_sums(self._V, self.damping.apply(v))

    def start_volume_damping(self, v: Array) -> Array:
        """Return the forces [N] of a pressure's viscous part at a velocity, (owned dofs,).

        Zero without an unknown pressure or damping. Collective.
        """
        if not (self.damping and (rates := self.damping.rates)):
            return np.zeros(self._mass.num_owned)
        rate = rates.of_velocity(v[: self._mass.num_owned])
        return self.damping.beta * rates.forces(rate)

    def begin_volume_damping(self, problem: Problem, velocity: Affine) -> None:
        r"""Make an unknown pressure include its viscous part during a step. Collective.

        With the rate c and the origin w of the step's velocity, and u_0 and p_0 at its start, the
        rate of the elastic pressure is

        .. math:: \dot p_e = c (p_e - p_0) + C^{-1} B \, c (u_0 - w) .
        """
        if not (self.damping and (rates := self.damping.rates)):
            return
        u, p = problem.split(problem.x)
        assert p is not None
        known = velocity(local_values(u))[: self._mass.num_owned]
        origin = p.duplicate()
        p.copy(origin)
        origin.array[:] -= rates.of_velocity(known).array_r / velocity.rate
        update_ghosts(origin)
        ratio = self.damping.beta * velocity.rate
        self._pressure_damping = ratio, origin
        problem.elastic.set_pressure_damping(ratio, local_values(origin).copy())

    def end_volume_damping(self, problem: Problem, accepted: bool = True) -> Array:
        """Remove the viscous part from an unknown pressure in ``problem.x``; return its forces.

        Collective.

        Returns
        -------
        (owned dofs,)
            Forces [N]; zero if the step is not accepted, whose pressure is left as it is.
        """
        forces: Array = np.zeros(self._mass.num_owned)
        if not (self.damping and (rates := self.damping.rates)):
            return forces
        problem.elastic.set_pressure_damping()
        if accepted:
            assert problem.saddle_point
            before = self.other_forces(problem, [problem.elastic])
            ratio, origin = self._pressure_damping
            p = problem.saddle_point.pressure_dofs(problem.x)
            p[:] = np.where(rates.compliant, (p + ratio * origin.array_r) / (1 + ratio), p)
            forces = before - self.other_forces(problem, [problem.elastic])
        return forces

    def inertial_forces(self, a: Array) -> Array:
        """Return M a [N], (owned dofs,), of an acceleration (local dofs,). Collective."""
        return owned_sums(self._V, self._mass.apply(a))

    def other_forces(self, problem: Problem, terms: Sequence[Any] | None = None) -> Array:
        """Return the forces dE/du [N] of terms at the present state, (owned dofs,). Collective.

        Default: all terms but inertia and damping.
        """
        if terms is None:
            terms = [t for t in problem.terms if t not in self.terms]
        return np.array(problem.gradient_at(problem.x, terms).array_r[: self._mass.num_owned])

    def smooth_forces(self, problem: Problem) -> Array:
        """Return `other_forces` without the terms that have mean forces. Collective."""
        excluded = [*self.terms, *mean_force_terms(problem)]
        return self.other_forces(problem, [t for t in problem.terms if t not in excluded])

    def weight_mean_forces(self, problem: Problem, weight: float | None) -> None:
        """Set the weight of the mean forces: see `MeanForceTerm`."""
        for term in mean_force_terms(problem):
            term.weight_mean_forces(weight)

    def mean_forces(self, problem: Problem, weight: float | None = 1.0) -> MeanForces | None:
        """Return the mean forces of a step times ``weight``; None if no term has any. Collective.

        With ``weight`` None they are the present forces. The terms keep the weight, and the
        problem's matrix is overwritten.
        """
        if not (terms := mean_force_terms(problem)):
            return None
        self.weight_mean_forces(problem, weight)
        forces = self.other_forces(problem, terms)
        a: Array = np.zeros(_dolfinx.num_components(self._V) * sum(_dolfinx.num_nodes(self._V)))
        if problem.comm.allreduce(bool(forces.any()), op=MPI.LOR):
            a = self.acceleration(problem, forces, a)
        return MeanForces(forces, a)

    def acceleration(self, problem: Problem, forces: Array, prescribed: Array) -> Array:
        """Return the acceleration that balances forces. Collective.

        Parameters
        ----------
        problem : Problem
            The problem. Its matrix is overwritten.
        forces : (owned dofs,)
            All forces but those of inertia [N].
        prescribed : (local dofs,)
            The acceleration [m/s^2] in constrained directions, zero in others.

        Returns
        -------
        (local dofs,)
            The acceleration [m/s^2], ghosts included.
        """
        force, rigid = -forces - self.inertial_forces(prescribed), problem.rigid
        if rigid:
            nodal = vector_like(problem.x, force)
            rigid.reduce_vector(problem.x, nodal)
            force = nodal.array_r[: len(force)].copy()
            rigid.prepare_mass(problem.x)
        found = self._mass.solve(problem.matrix, problem.project, force)
        if rigid:
            rigid.expand(problem.x, found)
        return prescribed + with_ghosts(self._V, found)


def mean_force_terms(problem: Problem) -> list[Any]:
    """Return the terms of a problem that have mean forces."""
    return [term for term in problem.terms if isinstance(term, MeanForceTerm)]


#: Added to the inertia of a cell's nodes, relative to its trace, as the inertia of a line about
#: itself is zero. It is above rounding.
_SMALLEST = 1e-14


def cell_rotations(x: Array, v: Array, time: float, revolved: bool = False) -> Array:
    r"""Return the rotations of cells that rotate with their present spin for a time.

    The spin :math:`\omega` of a cell is the angular velocity that is closest to the velocity of its
    nodes in least squares,

    .. math:: \sum_a \left(|r_a|^2 I - r_a r_a^T\right) \omega = \sum_a r_a \times v_a ,

    with the nodes' positions r from their mean. The rotation is Cayley's map of
    :math:`t \omega / 2`, by which the trapezoidal rule turns a rigid body. A body of revolution is
    rigid only in rotations about its axis y: r is then the vector from the axis.

    Parameters
    ----------
    x, v : (cells, nodes, 3)
        Positions [m] and velocities [m/s] of the nodes of each cell.
    time : float
        The time t [s].
    revolved : bool, optional
        Whether they are cells of a body of revolution.

    Returns
    -------
    (cells, 3, 3)
    """
    if revolved:
        w: Array = np.zeros((len(x), 3))
        w[:, 1] = np.cross(x, v)[..., 1].sum(axis=1) / (x[..., ::2] ** 2).sum(axis=(1, 2))
    else:
        r = x - x.mean(axis=1, keepdims=True)
        squares = np.einsum("cai,caj->cij", r, r)
        inertia = np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        moment = np.cross(r, v).sum(axis=1)[..., None]
        w = np.linalg.solve(inertia * (1 + _SMALLEST) - squares, moment)[..., 0]
    half = time / 2 * w
    W = skew(half)
    factor = 2 / (1 + (half**2).sum(axis=1))[:, None, None]
    return np.asarray(np.eye(3) + factor * (W + W @ W))
