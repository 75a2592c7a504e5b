"""The weight of a body in motion, from its mass matrix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.assembly.unknowns import add_ghosts, update_ghosts, writable_values
from fem_snh.terms.body import present
from fem_snh.terms.term import Term


class Weight(Term):
    r"""The forces of a mass matrix times uniform accelerations, each scaled by an amplitude.

    .. math:: E = -\sum_i a_i(\lambda) M g_i \cdot u

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mass : NodalMass
        The mass matrix M.
    accelerations : sequence of (acceleration, amplitude)
        The accelerations g_i [m/s^2], numbers or uniform UFL expressions with the components of the
        displacement, and the amplitudes a_i, functions of the load.
    """

    name, has_hessian = "gravity", False
    has_energy = depends_on_load = stateless = True

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        mass: NodalMass,
        accelerations: Sequence[tuple[Any, Callable[[float], float]]],
    ) -> None:
        self._mass, self._accelerations = mass, accelerations
        self._forces = _dolfinx.create_vector(V)

    def set_load(self, load: float) -> None:
        """Set the load parameter lambda, and evaluate the forces. Collective."""
        total = sum(amplitude(load) * present(g) for g, amplitude in self._accelerations)
        values = writable_values(self._forces)
        values[:] = self._mass.apply(np.resize(total, len(values)))
        add_ghosts(self._forces)
        update_ghosts(self._forces)

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the potential energy of the forces [J], zero at u = 0. Collective."""
        return -float(self._forces.dot(u))

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Subtract the forces [N] from the owned entries of ``r_u``."""
        r_u.array[:] -= self._forces.array_r
