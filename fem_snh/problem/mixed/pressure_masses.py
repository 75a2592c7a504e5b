"""Mass matrices of a pressure space, with the compliances of the materials as coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.regions import cell_constant
from fem_snh.terms.elastic import Part


class ScaledMass(NamedTuple):
    """A mass matrix of a pressure space with a coefficient: ``scale`` times ``matrix``."""

    scale: float
    matrix: PETSc.Mat

    @property
    def diagonal(self) -> np.ndarray:
        """The diagonal of ``scale`` times ``matrix``, (owned pressures,)."""
        return self.scale * np.asarray(self.matrix.getDiagonal().array_r)


class PressureMasses:
    """Mass matrices of a pressure space, times the square of the pressure's unit. Collective.

    Parameters
    ----------
    Q : dolfinx function space
        The pressure's space.
    parts : sequence of Part
        The body's materials, with the energies that the element evaluates.
    unit : float
        Unit of the pressure unknown [Pa/m].
    """

    def __init__(self, Q: _dolfinx.FunctionSpace, parts: Sequence[Part], unit: float) -> None:
        self._Q, self._parts, self._unit = Q, parts, unit

    @cached_property
    def shear_compliance(self) -> ScaledMass:
        """The mass matrix with the coefficient 1/mu."""
        return self._with([1 / mu for mu, _ in self._moduli()])

    @cached_property
    def volume_compliance(self) -> ScaledMass:
        """The mass matrix with the coefficient 1/U''(1), 0 at nu = 0.5."""
        return self._with([1 / part.loops.constants.volume_stiffness for part in self._parts])

    @cached_property
    def lambda_over_mu(self) -> float | np.ndarray:
        """lambda_local / mu: a number, or for several regions nodal means, (owned pressures,)."""
        ratios = [part.loops.constants.lambda_local / mu for mu, part in self._moduli()]
        if len(ratios) == 1:
            return ratios[0]
        return self._with(ratios).diagonal / np.asarray(self.plain.getDiagonal().array_r)

    @cached_property
    def plain(self) -> PETSc.Mat:
        """The mass matrix without a coefficient; in a lattice, of the filled part of cells."""
        regions = [part.region for part in self._parts]
        if all(region.fractions is None for region in regions):
            return self._assembled(1.0)
        return self._assembled(cell_constant(self._Q.mesh, regions, [1.0] * len(regions)))

    def _moduli(self) -> list[tuple[float, Part]]:
        """Return (shear modulus at rest [Pa], part) of each part."""
        return [(part.region.material.lame[0], part) for part in self._parts]

    def _with(self, values: Sequence[float]) -> ScaledMass:
        """Return the mass matrix whose coefficient has the i-th value in the i-th region."""
        if len(values) == 1:
            return ScaledMass(values[0], self.plain)
        regions = [part.region for part in self._parts]
        coefficient = cell_constant(self._Q.mesh, regions, values)
        return ScaledMass(1.0, self._assembled(coefficient))

    def _assembled(self, coefficient: Any) -> PETSc.Mat:
        """Assemble the mass matrix with a coefficient: a number or a dolfinx Function.

        Zeros on the diagonal, where no cell is assembled, become the mean of the diagonal.
        """
        Q = self._Q
        p, q = ufl.TrialFunction(Q), ufl.TestFunction(Q)
        factor = _dolfinx.constant(Q.mesh, np.array(self._unit**2))
        if self._parts[0].loops.tables.kinematics.revolved:
            factor *= 2 * ufl.pi * _dolfinx.coordinates(Q.mesh)[0]
        form = _dolfinx.form(factor * coefficient * p * q * ufl.dx)
        M = _dolfinx.create_matrix(form)
        _dolfinx.assemble_matrix(M, form)
        diagonal = M.getDiagonal()
        masses = diagonal.array  # zero where no cell is assembled
        masses[masses == 0] = diagonal.sum() / diagonal.getSize()
        M.setDiagonal(diagonal)
        return M
