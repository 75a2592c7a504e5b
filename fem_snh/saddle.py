"""The pressure of a Taylor-Hood problem, as a solver needs to know it."""

from __future__ import annotations

from functools import cached_property

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.terms import Elastic
from fem_snh.unknowns import DisplacementPressure


class Saddle:
    """Which unknowns are the pressure's, and the matrix that its Schur complement resembles.

    Attributes
    ----------
    fields : {"u": IS, "p": IS}, the unknowns of each.
    Q : the pressure's space.
    weights : (owned pressures,) 1/(each one's share of the volume), in the units of x and residual:
        the square of the residual's other half, so weighted, is that of a volume's error [m^3].
    """

    def __init__(
        self, unknowns: DisplacementPressure, elastic: Elastic, scale: float, mu_lame: float
    ) -> None:
        self._unknowns, self._scale = unknowns, scale
        self.fields, self.Q = unknowns.fields, unknowns.Q
        elastic.pressure, elastic.residual_pressure = unknowns.pressure, unknowns.residual_pressure
        self._compliance = 1 / mu_lame + 1 / elastic.law.stiffness

    def pressures(self, x: PETSc.Vec) -> np.ndarray:
        """The owned pressures' part of a vector, in units of E/L [Pa/m]."""
        return self._unknowns.pressures(x)

    def pressure(self) -> np.ndarray:
        """The pressure's nodal values [Pa], ghosts included, of the vector last evaluated.

        U'(J), positive in tension: what the part of lambda that `materials.split` leaves to the
        displacement adds to the mean stress is not in it.
        """
        with self._unknowns.pressure.localForm() as local:
            return self._scale * np.asarray(local.array_r)

    @cached_property
    def schur(self) -> PETSc.Mat:
        """-(1/mu + 1/U'') M, M the pressure's mass matrix [m^3]: what -(B H^-1 B^T + C) is like.

        With the shear modulus at rest; exact in the sense of the inf-sup condition, whatever nu.
        """
        Q = self.Q
        p, q = ufl.TrialFunction(Q), ufl.TestFunction(Q)
        factor = _dolfinx.constant(Q.mesh, np.array(-self._compliance * self._scale**2))
        form = _dolfinx.form(factor * p * q * ufl.dx)
        M = _dolfinx.create_matrix(form)
        _dolfinx.assemble_matrix(M, form)
        return M

    @cached_property
    def weights(self) -> np.ndarray:
        ones, sums = self.schur.createVecs()
        ones.set(1.0)
        self.schur.mult(ones, sums)
        return -self._compliance / np.asarray(sums.array_r)
