"""The pressure of a Taylor-Hood problem, as a solver needs to know it."""

from __future__ import annotations

from functools import cached_property

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.fem.terms import Elastic
from fem_snh.fem.unknowns import DisplacementPressure


class SaddlePoint:
    """Which unknowns are the pressure's, and the matrix that its Schur complement resembles.

    Attributes
    ----------
    index_sets : {"u": IS, "p": IS}, the unknowns of each.
    Q : the pressure's space.
    inverse_lumped_mass : (owned pressures,) in the units of x and residual. The pressure residual's
        square, so weighted, is the square of a volume error [m^3].
    """

    def __init__(
        self, unknowns: DisplacementPressure, elastic: Elastic, scale: float, mu_lame: float
    ) -> None:
        self._unknowns, self._scale = unknowns, scale
        self.index_sets, self.Q = unknowns.index_sets, unknowns.Q
        elastic.pressure, elastic.residual_pressure = unknowns.pressure, unknowns.residual_pressure
        self._shear, self._compliance = 1 / mu_lame, 1 / elastic.law.volume_stiffness
        self._local = elastic.law.lambda_local / mu_lame
        self._B: PETSc.Mat | None = None

    def pressure_dofs(self, x: PETSc.Vec) -> np.ndarray:
        """The owned pressures' part of a vector, in units of E/L [Pa/m]."""
        return self._unknowns.pressure_dofs(x)

    def pressure(self) -> np.ndarray:
        """The pressure's nodal values [Pa], ghosts included, of the vector last evaluated.

        U'(J), positive in tension: what the part of lambda that `materials.split` leaves to the
        displacement adds to the mean stress is not in it.
        """
        with self._unknowns.pressure.localForm() as local:
            return self._scale * np.asarray(local.array_r)

    @cached_property
    def schur_approximation(self) -> PETSc.Mat:
        """-(1/mu + 1/U'') M, M the pressure's mass matrix [m^3]: what -(B H^-1 B^T + C) is like.

        With the shear modulus at rest; exact in the sense of the inf-sup condition, whatever nu.
        `update_schur_approximation` corrects the first term.
        """
        matrix = self._mass.copy()
        matrix.scale(-self._shear - self._compliance)
        return matrix

    @cached_property
    def inverse_lumped_mass(self) -> np.ndarray:
        ones, sums = self._mass.createVecs()
        ones.set(1.0)
        self._mass.mult(ones, sums)
        return 1 / np.asarray(sums.array_r)

    def update_schur_approximation(self, A: PETSc.Mat) -> None:
        """Correct `schur_approximation` where nodes are constrained, or strains are large.

        How much they move is in d = diag(B D^-1 B^T)/diag(M), D the diagonal of H (as in SIMPLE),
        constant where nothing holds them and B H^-1 B^T is M/(2 mu + lambda_local). So with
        s = d/(2 mean d), and lambda_local in parallel, a pressure's share of M/mu is
        s/(1 + s lambda_local/mu), here over its value at s = 1/2. Collective.
        """
        d = self._mobility(A)
        mass = self._mass.getDiagonal().array_r
        sums = self.Q.mesh.comm.allreduce(np.array([d.sum(), mass.sum()]))
        s = d / mass * sums[1] / (2 * sums[0])
        share = s * (2 + self._local) / (1 + s * self._local)
        root = self._mass.createVecLeft()
        root.array[:] = np.sqrt(share)
        self._mass.copy(self.schur_approximation)
        self.schur_approximation.diagonalScale(root, root)
        self.schur_approximation.scale(-self._shear)
        same = PETSc.Mat.Structure.SAME_NONZERO_PATTERN
        self.schur_approximation.axpy(-self._compliance, self._mass, same)

    def _mobility(self, A: PETSc.Mat) -> np.ndarray:
        """(owned pressures,) diag(B D^-1 B^T) of A = [[H, B^T], [B, -C]]."""
        u, p = self.index_sets["u"], self.index_sets["p"]
        self._B = B = A.createSubMatrix(p, u, self._B)
        root = B.createVecRight()
        root.array[:] = np.abs(A.getDiagonal().array_r[: root.getLocalSize()]) ** -0.5
        B.diagonalScale(R=root)
        starts, _, b = B.getValuesCSR()
        return np.add.reduceat(b**2, starts[:-1]) if len(b) else np.zeros(len(starts) - 1)

    @cached_property
    def _mass(self) -> PETSc.Mat:
        Q = self.Q
        p, q = ufl.TrialFunction(Q), ufl.TestFunction(Q)
        factor = _dolfinx.constant(Q.mesh, np.array(self._scale**2))
        form = _dolfinx.form(factor * p * q * ufl.dx)
        M = _dolfinx.create_matrix(form)
        _dolfinx.assemble_matrix(M, form)
        return M
