r"""Inertia as an incremental potential of the displacement at a step's end."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy.typing as npt

from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.ghosted_vectors import local_values, writable_values
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.steps.dynamics.integrators import Affine

Array = npt.NDArray[Any]


class Inertia:
    r"""The potential of the inertial forces, and of constant forces.

    .. math:: E(u) = \frac{c}{2} (u - w) \cdot M (u - w) + g \cdot u

    Its derivative is :math:`M a + g` with :math:`a = c (u - w)`. In a step, g are forces of the
    step's start. Between steps the acceleration is that of the last state, and its forces are in g.

    Parameters
    ----------
    mass : NodalMass
        The mass matrix M.

    Attributes
    ----------
    acceleration : Affine or None
        a as a function of the displacement; None without a step.
    constant : (3 owned nodes,) or None
        The forces g [N].
    """

    name = "inertia"
    has_energy = depends_on_load = True

    def __init__(self, mass: NodalMass) -> None:
        self._mass = mass
        self.acceleration: Affine | None = None
        self.constant: Array | None = None

    def set_load(self, load: float) -> None:
        """Do nothing: `Dynamics.begin_step` sets the formulas of a step."""

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
        """Add the forces [N] to all entries of ``r_u``, ghosts included."""
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
