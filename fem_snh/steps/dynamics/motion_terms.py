"""Inertia and damping as incremental potentials of the displacement at a step's end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import jacobi_cg
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.nodal_mass import NodalMass, StoredMatrix
from fem_snh.assembly.unknowns import local_values, writable_values
from fem_snh.steps.dynamics.integrators import Affine
from fem_snh.terms.term import Term

#: Relative tolerance of the solves for rates of a pressure, and the compliance, relative to the
#: largest one, up to which it is rounding.
_RTOL, _INCOMPRESSIBLE = 1e-12, 1e-14


class _MotionTerm(Term):
    """The base of inertia and damping; `Dynamics.begin_step` sets the formulas of a step."""

    has_energy = depends_on_load = True


class Inertia(_MotionTerm):
    r"""The potential of the inertial forces, and of constant forces.

    .. math:: E(u) = \frac{c}{2} (u - w) \cdot M (u - w) + g \cdot u

    Its derivative is :math:`M a + g` with :math:`a = c (u - w)`. In a step, g are forces of the
    step's start. Between steps ``acceleration`` is None, and g contains the inertial forces.

    Parameters
    ----------
    mass : NodalMass
        The mass matrix M.

    Attributes
    ----------
    acceleration : Affine or None
        a as a function of the displacement; None between steps.
    constant : (owned dofs,) or None
        The forces g [N].
    """

    name = "inertia"

    def __init__(self, mass: NodalMass) -> None:
        self._mass = mass
        self.acceleration: Affine | None = None
        self.constant: Array | None = None

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the potential [J]. Collective."""
        energy = 0.0
        if self.acceleration is not None:
            a = self.acceleration(local_values(u))
            energy += self._mass.dot(a, a) / (2 * self.acceleration.rate)
        if self.constant is not None:
            energy += u.comm.tompi4py().allreduce(float(self.constant @ u.array_r))
        return energy

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to the local entries of ``r_u``: parts to be summed over ranks."""
        values = writable_values(r_u)
        if self.acceleration is not None:
            values += self._mass.apply(self.acceleration(local_values(u)))
        if self.constant is not None:
            values[: len(self.constant)] += self.constant

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add c M, and return 0: it is positive definite."""
        if self.acceleration is not None:
            self._mass.add_to(target, self.acceleration.rate)
        return 0


class RayleighDamping(_MotionTerm):
    r"""The potential of damping forces proportional to the velocity.

    .. math:: E(u) = \frac{1}{2 c} v \cdot C v, \qquad v = c (u - w), \qquad C = \alpha M + \beta K

    Its derivative is C v. K is the Hessian of the elastic energy at the step's start, clamped and
    without the stiffness of spins, and turned with its cells: C is constant in a step, positive
    semidefinite, and does not damp the rotation of a cell (docs/theory/dynamics.md). K excludes the
    stiffness of an unknown pressure: see `VolumeRates`.

    Parameters
    ----------
    mass : NodalMass
        The mass matrix M.
    factors : tuple of float
        alpha [1/s] and beta [s].

    Attributes
    ----------
    velocity : Affine or None
        v as a function of the displacement; None between steps.
    beta : float
        The factor of K [s].
    rates : VolumeRates or None
        The rates of an unknown pressure; None without one.
    """

    name = "damping"

    def __init__(self, mass: NodalMass, factors: tuple[float, float]) -> None:
        self._mass, (self._alpha, self.beta) = mass, factors
        self.needs_aij = self.has_stiffness  # its stored matrix
        self.velocity: Affine | None = None
        self.rates: VolumeRates | None = None
        self._K: StoredMatrix | None = None
        self._vectors: tuple[PETSc.Vec, PETSc.Vec]

    @property
    def has_stiffness(self) -> bool:
        """Whether beta > 0, so that the elastic stiffness contributes."""
        return self.beta > 0

    def update_stiffness(
        self,
        matrix: BlockMatrix,
        x: PETSc.Vec,
        u: PETSc.Vec,
        add_hessian: Callable[[BlockMatrix], Any],
    ) -> None:
        """Assemble K, and set `rates`. Collective.

        Parameters
        ----------
        matrix : BlockMatrix
            The problem's matrix, whose layout K has.
        x, u : PETSc.Vec
            Vectors of the unknowns and of the displacement, for their layout.
        add_hessian : callable
            ``add_hessian(target)`` adds K to a BlockMatrix.
        """
        if self._K is None:
            self._K, self._vectors = StoredMatrix(matrix), (x.duplicate(), x.duplicate())
        self._K.assemble(add_hessian)
        self.rates = None
        if x.getSize() > u.getSize():
            self.rates = VolumeRates.of(self._K.mat, u.getLocalSize())
            # K is the displacement's block alone, without the coupling to a pressure.
            mask = self._vectors[0]
            mask.set(0.0)
            mask.array[: u.getLocalSize()] = 1.0
            self._K.mat.diagonalScale(mask, mask)

    def apply(self, v: Array) -> Array:
        """Return this rank's part of C v [N]. Collective.

        Parameters
        ----------
        v : (local dofs,)
            A velocity with current ghosts.

        Returns
        -------
        (local dofs,)
            To be summed over the ranks, as `add_ghosts` does.
        """
        force = self._alpha * self._mass.apply(v) if self._alpha else np.zeros_like(v)
        if self._K is not None:
            x, y = self._vectors
            owned = self._mass.num_owned
            x.set(0.0)
            x.array[:owned] = v[:owned]
            self._K.mat.mult(x, y)
            force[:owned] += self.beta * y.array_r[:owned]
        return force

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the potential [J]. Collective."""
        if self.velocity is None:
            return 0.0
        v = self.velocity(local_values(u))
        local = float(v @ self.apply(v)) / (2 * self.velocity.rate)
        return float(u.comm.tompi4py().allreduce(local))

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to the local entries of ``r_u``: parts to be summed. Collective."""
        if self.velocity is not None:
            values = writable_values(r_u)
            values += self.apply(self.velocity(local_values(u)))

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add c C, and return 0: it is positive semidefinite. Collective."""
        if self.velocity is not None:
            if self._alpha:
                self._mass.add_to(target, self._alpha * self.velocity.rate)
            if self._K is not None:
                self._K.add_to(target, self.beta * self.velocity.rate)
        return 0


class VolumeRates:
    r"""The rate of an unknown elastic pressure, linear in the velocity. Collective.

    With the blocks of the Hessian B = d2E/(dp du) and -C = d2E/dp2, the pressure that belongs to a
    displacement changes by

    .. math:: C \, \dot p = B v .

    Parameters
    ----------
    B, C : PETSc.Mat
        The blocks. Zeros on the diagonal of C are replaced by 1, in place.
    """

    def __init__(self, B: PETSc.Mat, C: PETSc.Mat) -> None:
        self._B, self._ksp = B, jacobi_cg(C.comm, rtol=_RTOL, atol=0.0)
        diagonal = C.getDiagonal()
        #: Which owned pressures have a compliance: all but those of incompressible cells alone.
        self.compliant = diagonal.array_r > _INCOMPRESSIBLE * diagonal.max()[1]
        diagonal.array[~self.compliant] = 1.0
        C.setDiagonal(diagonal)
        self._ksp.setOperators(C)

    @classmethod
    def of(cls, A: PETSc.Mat, num_u: int) -> VolumeRates | None:
        """Create the rates from the Hessian of displacement and pressure; None if C is zero.

        ``num_u`` is the number of displacement dofs that this rank owns.
        """
        first, end = A.getOwnershipRange()
        u, p = (
            PETSc.IS().createStride(size, start, 1, comm=A.comm)
            for size, start in ((num_u, first), (end - first - num_u, first + num_u))
        )
        C = A.createSubMatrix(p, p)
        C.scale(-1.0)
        return cls(A.createSubMatrix(p, u), C) if C.getDiagonal().max()[1] > 0 else None

    def of_velocity(self, v: Array) -> PETSc.Vec:
        """Return the rate of the pressure at a velocity (owned displacement dofs,)."""
        velocity, rate = self._B.createVecs()
        velocity.array[:] = v
        mismatch = self._B * velocity
        mismatch.array[~self.compliant] = 0.0
        self._ksp.solve(mismatch, rate)
        return rate

    def forces(self, p: PETSc.Vec) -> Array:
        """Return the forces B^T p [N] of a pressure, (owned displacement dofs,)."""
        forces = self._B.createVecRight()
        self._B.multTranspose(p, forces)
        return np.array(forces.array_r)
