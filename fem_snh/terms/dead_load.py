"""Forces that do not depend on the displacement, scaled by amplitudes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import BlockMatrix

#: A factor as a function of the load parameter; `float` is the load itself.
Amplitude = Callable[[float], float]


class DeadLoad:
    r"""Nodal forces, each scaled by an amplitude of the load.

    .. math:: E = -\sum_i a_i(\lambda) f_i \cdot u

    Parameters
    ----------
    name : str
        The term's name in run.json.
    V : dolfinx function space
        The displacement's space.
    """

    has_energy = depends_on_load = True

    def __init__(self, name: str, V: Any) -> None:
        self.name, self._V = name, V
        self._forces: list[tuple[Amplitude, PETSc.Vec]] = []
        self._scaled: list[tuple[float, PETSc.Vec]] = []

    def add(self, integral: Any, amplitude: Amplitude = float) -> None:
        """Add the force of a linear UFL form, assembled once. Collective."""
        part = _dolfinx.create_vector(self._V)
        _dolfinx.assemble_vector(part, _dolfinx.form(integral))
        self.add_forces(part, amplitude)

    def add_forces(self, part: PETSc.Vec, amplitude: Amplitude = float) -> None:
        """Add nodal forces [N], a ghosted vector of the displacement's space."""
        for other, force in self._forces:
            if other == amplitude:
                force.axpy(1.0, part)
                return
        self._forces.append((amplitude, part))

    def set_load(self, load: float) -> None:
        """Set the load parameter lambda."""
        self._scaled = [(amplitude(load), force) for amplitude, force in self._forces]

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the potential of the forces [J]. Collective."""
        return sum(-factor * float(force.dot(u)) for factor, force in self._scaled)

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Subtract the forces [N] from the owned entries of ``r_u``."""
        for factor, force in self._scaled:
            r_u.array[:] -= factor * force.array_r

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add nothing, and return 0: a dead load has no Hessian."""
        return 0
