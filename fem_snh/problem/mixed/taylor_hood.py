r"""The pressure block of an element with an unknown pressure, for block preconditioners.

With the pressure as an unknown, the energy is minimal in the displacement and maximal in the
pressure. Its Hessian, with U the volume term, is

.. math::

    A = \begin{pmatrix} H & B^T \\ B & -C \end{pmatrix},
    \qquad C_{ij} = \int \frac{q_i q_j}{U''} \, \mathrm{d}V .

The block preconditioner replaces the Schur complement :math:`-(B H^{-1} B^T + C)` by an
approximation: `NodalSchur` for continuous pressures, `CellSchur` for cell pressures.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.assembly.unknowns import DisplacementPressure, local_values
from fem_snh.problem.mixed.cell_schur import CellSchur
from fem_snh.problem.mixed.nodal_schur import NodalSchur
from fem_snh.problem.mixed.pressure_masses import PressureMasses
from fem_snh.terms.elastic import Part


class PressureBlock:
    """The pressure block of a saddle-point problem and an approximation of its Schur complement.

    Parameters
    ----------
    unknowns : DisplacementPressure
        Displacement and pressure.
    parts : sequence of Part
        The body's materials, with the energies that the element evaluates.
    pressure_scale : float
        Unit of the pressure unknown [Pa/m].
    A : PETSc.Mat
        The problem's matrix, whose pattern is read.
    idle : (n,) int
        The owned pressures, numbered from 0, that are in no assembled cell.

    Attributes
    ----------
    index_sets : dict of PETSc.IS
        {"u": IS, "p": IS}, the global dofs of each field.
    Q : dolfinx function space
        The pressure's space.
    unit : float
        Unit of the pressure unknown [Pa/m].
    """

    def __init__(
        self,
        unknowns: DisplacementPressure,
        parts: Sequence[Part],
        pressure_scale: float,
        A: PETSc.Mat,
        idle: np.ndarray,
    ) -> None:
        self._unknowns, self.unit, self._A, self._idle = unknowns, pressure_scale, A, idle
        self.index_sets, self.Q = unknowns.index_sets, unknowns.Q
        self._masses = PressureMasses(self.Q, parts, pressure_scale)

    @property
    def cell_pressures(self) -> bool:
        """Whether the pressure is constant in each cell."""
        return _dolfinx.degree(self.Q) == 0

    def pressure_dofs(self, x: PETSc.Vec) -> np.ndarray:
        """Return a view of the owned pressure dofs in ``x``: pressure over `unit` [m]."""
        return self._unknowns.pressure_dofs(x)

    def pressure(self) -> np.ndarray:
        """Return the pressures (local dofs,) [Pa] of the vector that `Problem.split` got last.

        The pressure is U'(J), positive in tension, with ghosts. It excludes the mean stress of the
        part of lambda that `fem_snh.materials.volume_split` leaves to the displacement.
        """
        return self.unit * local_values(self._unknowns.pressure)

    @property
    def fields(self) -> tuple[PETSc.Vec, PETSc.Vec]:
        """The ghosted vectors of displacement and pressure, each with its own communicator."""
        return _dolfinx.petsc_vec(self._unknowns.u), self._unknowns.pressure

    @property
    def schur_approximation(self) -> PETSc.Mat:
        """The approximation of the Schur complement, negative definite: not a copy."""
        return self._schur.matrix

    def update_schur_approximation(self, A: PETSc.Mat) -> None:
        """Update `schur_approximation` for the assembled Hessian ``A``. Collective."""
        self._schur.update(A)

    def begin_step(self) -> None:
        """Forget the approximation of the last step, as a resumed run does not have it."""
        if isinstance(self._schur, CellSchur):
            self._schur.begin_step()

    @cached_property
    def _schur(self) -> NodalSchur | CellSchur:
        if self.cell_pressures:
            return CellSchur(self._A, self.index_sets, self._masses)
        return NodalSchur(self._masses, self.index_sets["u"].getLocalSize(), self._idle)

    @cached_property
    def inverse_lumped_mass(self) -> np.ndarray:
        """The inverse of the lumped mass matrix, (owned pressures,), in the units of ``x``.

        The square of the pressure residual, weighted by it, is the square of a volume error [m^3].
        The lumped masses are row sums; for pressures of degree 2, whose row sums are zero or
        negative at vertices, the diagonal is scaled to the same sum.
        """
        ones, sums = self._masses.plain.createVecs()
        ones.set(1.0)
        self._masses.plain.mult(ones, sums)
        if _dolfinx.degree(self.Q) > 1:
            volume = sums.sum()
            self._masses.plain.getDiagonal(sums)
            sums.scale(volume / sums.sum())
        return 1 / np.asarray(sums.array_r)

    def pressure_correction(self, residual: PETSc.Vec) -> np.ndarray:
        """Return C^-1 times the pressure's part of a residual, (owned pressures,).

        C is of the undeformed body, and diagonal: the pressure must be constant in each cell.
        """
        compliance = self._masses.volume_compliance.diagonal
        correction: np.ndarray = self.pressure_dofs(residual) / compliance
        return correction
