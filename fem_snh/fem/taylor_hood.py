r"""The saddle-point problem of a Taylor-Hood element, as a solver needs to know it.

With the pressure as an unknown, the energy is minimal in the displacement and maximal in the
pressure. Its Hessian, with U* the conjugate of the volume term U(J), is

.. math::

    A = \begin{pmatrix} H & B^T \\ B & -C \end{pmatrix},
    \qquad C_{ij} = \int \frac{q_i q_j}{U''} \, \mathrm{d}V .

The block preconditioner replaces the Schur complement :math:`-(B H^{-1} B^T + C)` by scaled mass
matrices of the pressure space.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh._petsc import aij_blocks
from fem_snh.fem.cell_schur import CellSchur
from fem_snh.fem.ghosted_vectors import local_values
from fem_snh.fem.regions import cell_constant
from fem_snh.fem.terms.elastic import Part
from fem_snh.fem.unknowns import DisplacementPressure

#: Factor of the shear part of the Schur complement's approximation. In the interior 1 would be
#: right, but at clamped boundaries and large strains it is too small, which costs more iterations
#: than an approximation that is too large (docs/results/elements_taylor_hood.md).
_SCALE = 1.5
#: The same for the mean pressures of `CellSchur` (docs/results/elements_cell_pressures.md).
_CELL_SCALE = 0.75


class _ScaledMass(NamedTuple):
    """The mass matrix of a pressure space with a coefficient: ``scale`` times ``matrix``."""

    scale: float
    matrix: PETSc.Mat


class SaddlePoint:
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
        The problem's matrix, of which the pattern is read.

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
    ) -> None:
        self._unknowns, self.unit, self._A = unknowns, pressure_scale, A
        self.index_sets, self.Q = unknowns.index_sets, unknowns.Q
        self._parts = parts

    @property
    def cell_pressures(self) -> bool:
        """Whether the pressure is constant in each cell."""
        return _dolfinx.degree(self.Q) == 0

    def pressure_dofs(self, x: PETSc.Vec) -> np.ndarray:
        """Return a view of the pressure dofs that this rank owns in ``x``, in the unit of ``x``."""
        return self._unknowns.pressure_dofs(x)

    def pressure(self) -> np.ndarray:
        """Return the nodal pressures [Pa], ghosts included, of the vector evaluated last.

        This is U'(J), positive in tension. It excludes the mean stress of the part of lambda that
        `fem_snh.materials.volume_split` leaves to the displacement.
        """
        return self.unit * local_values(self._unknowns.pressure)

    @cached_property
    def schur_approximation(self) -> PETSc.Mat:
        """The mass matrix of the pressure with the coefficient -(1/mu + 1/U''(1)) [m^3/Pa].

        With the shear modulus at rest it is spectrally equivalent to the Schur complement for any
        Poisson's ratio (inf-sup condition). `update_schur_approximation` improves it. For pressures
        that are constant in each cell it is that of `CellSchur`.
        """
        if self.cell_pressures:
            return self._cell_schur.matrix
        coefficients = [
            -1 / mu - 1 / part.loops.constants.volume_stiffness for mu, part in self._moduli()
        ]
        scale, mass = self._mass_with(coefficients)
        matrix = mass.copy()
        matrix.scale(scale)
        return matrix

    @cached_property
    def inverse_lumped_mass(self) -> np.ndarray:
        """(owned pressures,) inverse of the lumped mass matrix, in the units of ``x`` and residual.

        The square of the pressure residual, weighted by it, is the square of a volume error [m^3].
        """
        ones, sums = self._mass.createVecs()
        ones.set(1.0)
        self._mass.mult(ones, sums)
        return 1 / np.asarray(sums.array_r)

    def pressure_correction(self, residual: PETSc.Vec) -> np.ndarray:
        """Return C^-1 times the pressure's residual, with C at rest: (owned pressures,).

        For pressures that are constant in each cell, where C is diagonal.
        """
        compliance = self._volume_compliance
        diagonal = np.asarray(compliance.matrix.getDiagonal().array_r)
        correction: np.ndarray = self.pressure_dofs(residual) / (compliance.scale * diagonal)
        return correction

    def update_schur_approximation(self, A: PETSc.Mat) -> None:
        r"""Scale the approximation by the local compliance of the displacement. Collective.

        Constrained nodes and large strains reduce :math:`B H^{-1} B^T` locally. The scaling uses

        .. math:: d = \mathrm{diag}(B D^{-1} B^T) / \mathrm{diag}(M), \quad D = \mathrm{diag}(H)

        (as in the SIMPLE method), with the mass matrix M of coefficient 1/mu. In the interior of an
        unstrained region d is constant, and :math:`B H^{-1} B^T = M / (2 + \lambda_{local}/\mu)`.
        With s = d / (2 mean d) and lambda_local in parallel, the factor of M is ``_SCALE`` times
        s / (1 + s lambda_local/mu), which is that value at s = 1/2. Without a free node s is 1/2.
        That is for continuous pressures; `CellSchur` is for others.

        Parameters
        ----------
        A : PETSc.Mat
            The assembled Hessian.
        """
        if self.cell_pressures:
            self._cell_schur.update(A)
            return
        d = self._diagonal_of_schur_complement(A)
        shear = self._shear_compliance
        mass = shear.matrix.getDiagonal().array_r
        sums = self.Q.mesh.comm.allreduce(np.array([d.sum(), mass.sum()]))
        s = d / mass * sums[1] / (2 * sums[0]) if sums[0] else np.full(len(d), 0.5)
        ratio = self._lambda_over_mu
        factor = _SCALE * s / (1 + s * ratio)
        root = shear.matrix.createVecLeft()
        root.array[:] = np.sqrt(factor)
        schur, same = self.schur_approximation, PETSc.Mat.Structure.SAME_NONZERO_PATTERN
        shear.matrix.copy(schur)
        schur.diagonalScale(root, root)
        schur.scale(-shear.scale)
        schur.axpy(-self._volume_compliance.scale, self._volume_compliance.matrix, same)

    @cached_property
    def _cell_schur(self) -> CellSchur:
        """The approximation for pressures that are constant in each cell."""
        shear = self._shear_compliance
        mass = _CELL_SCALE * shear.scale * shear.matrix.getDiagonal().array_r
        return CellSchur(self._A, self.index_sets, mass / (2 + self._lambda_over_mu))

    def _diagonal_of_schur_complement(self, A: PETSc.Mat) -> np.ndarray:
        """(owned pressures,) diag(B D^-1 B^T)."""
        weights = A.getDiagonal()
        num_u, local = self.index_sets["u"].getLocalSize(), weights.array
        local[:num_u] = 1 / np.abs(local[:num_u])
        local[num_u:] = 0.0  # of C
        d = np.zeros(len(local) - num_u)
        with aij_blocks(A, read_only=True) as blocks:
            for k, block in enumerate(blocks):
                weight = _values_at(weights, block.ghosts) if k else local
                start, column = block.csr()
                entries, length = slice(start[num_u], start[-1]), np.diff(start[num_u:])
                terms = block.array()[entries] ** 2 * weight[column[entries]]
                filled = length > 0
                if filled.any():
                    d[filled] += np.add.reduceat(terms, start[num_u:-1][filled] - start[num_u])
        return d

    @cached_property
    def _shear_compliance(self) -> _ScaledMass:
        """The mass matrix with the coefficient 1/mu."""
        return self._mass_with([1 / mu for mu, _ in self._moduli()])

    @cached_property
    def _volume_compliance(self) -> _ScaledMass:
        """The mass matrix with the coefficient 1/U''(1), 0 at nu = 0.5."""
        return self._mass_with([1 / part.loops.constants.volume_stiffness for part in self._parts])

    @cached_property
    def _lambda_over_mu(self) -> float | np.ndarray:
        """lambda_local / mu; of several regions (owned pressures,), the mean at each node."""
        ratios = [part.loops.constants.lambda_local / mu for mu, part in self._moduli()]
        if len(ratios) == 1:
            return ratios[0]
        scale, mass = self._mass_with(ratios)
        diagonal = np.asarray(mass.getDiagonal().array_r)
        return scale * diagonal / np.asarray(self._mass.getDiagonal().array_r)

    @cached_property
    def _mass(self) -> PETSc.Mat:
        """The pressure mass matrix, in the units of ``x`` and residual."""
        regions = [part.region for part in self._parts]
        if all(region.fractions is None for region in regions):
            return self._assembled_mass(1.0)
        return self._assembled_mass(cell_constant(self.Q.mesh, regions, [1.0] * len(regions)))

    def _moduli(self) -> list[tuple[float, Part]]:
        """Return the shear modulus at rest [Pa] of each part."""
        return [(part.region.material.lame[0], part) for part in self._parts]

    def _mass_with(self, values: Sequence[float]) -> _ScaledMass:
        """Return the mass matrix with a coefficient that has one value in each region."""
        if len(values) == 1:
            return _ScaledMass(values[0], self._mass)
        regions = [part.region for part in self._parts]
        coefficient = cell_constant(self.Q.mesh, regions, values)
        return _ScaledMass(1.0, self._assembled_mass(coefficient))

    def _assembled_mass(self, coefficient: Any) -> PETSc.Mat:
        """Return the mass matrix with a coefficient: a number or a dolfinx Function."""
        Q = self.Q
        p, q = ufl.TrialFunction(Q), ufl.TestFunction(Q)
        factor = _dolfinx.constant(Q.mesh, np.array(self.unit**2))
        form = _dolfinx.form(factor * coefficient * p * q * ufl.dx)
        M = _dolfinx.create_matrix(form)
        _dolfinx.assemble_matrix(M, form)
        return M


def _values_at(x: PETSc.Vec, unknowns: np.ndarray) -> np.ndarray:
    """Return the values of a vector at unknowns of any rank. Collective."""
    found = PETSc.Vec().createSeq(len(unknowns), comm=PETSc.COMM_SELF)
    wanted = PETSc.IS().createGeneral(unknowns, comm=PETSc.COMM_SELF)
    scatter = PETSc.Scatter().create(x, wanted, found, None)
    scatter.scatter(x, found)
    return np.asarray(found.array_r)
