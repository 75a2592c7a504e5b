"""The elastic energy by forms that FFCx compiles; the filtered Hessian remains the kernels'."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import sympy
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.elements import Element
from fem_snh.assembly.regions import Region, cell_constant
from fem_snh.assembly.unknowns import copy_to_function
from fem_snh.errors import bad_value
from fem_snh.kernels.ufl_forms import FUNCTIONS, energy_density
from fem_snh.materials.functions import MEASURES
from fem_snh.materials.parameters import BOUNDS
from fem_snh.materials.volume_split import PRESSURE, Split, split
from fem_snh.terms.body import WeightedMeasure, displacement_gradient, of_the_body
from fem_snh.terms.elastic import Elastic
from fem_snh.terms.mean_volume import MeanJ

Array = npt.NDArray[Any]


class ElasticForms(Elastic):
    r"""The elastic energy and its derivative, differentiated by UFL and assembled by dolfinx.

    With the deviatoric part and the volume term U of `fem_snh.materials.volume_split`, the forms
    are, by the element's volume treatment,

    .. math::

        \text{pointwise} \quad & \int \psi(F) \, \mathrm{d}V \\
        \text{mean} \quad & \int \psi'(F) \, \mathrm{d}V + \sum_e V_e U(J_e), \qquad
            J_e = \frac{1}{V_e} \int_e J \, \mathrm{d}V \\
        \text{pressure} \quad & \int \psi'(F) + p J - U^*(p) \, \mathrm{d}V

    The residual of the second has U'(J_e) as a coefficient, with the mean ratio J_e of each cell.

    Parameters are those of `Elastic`; every material must have an energy.

    Raises
    ------
    BadInput
        On every rank, also for a material that is defined by a stress.
    """

    assembly = "ufl"

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        element: Element,
        regions: Sequence[Region],
        Q: _dolfinx.FunctionSpace = None,
        pressure_scale: float = 1.0,
    ) -> None:
        if element.kinematics.plane_stress:
            raise bad_value("assembly", "ufl", "'kernels', in plane stress")
        for material in (region.material for region in regions):
            if not material.has_energy:
                accepted = f"'kernels' for '{material.name}', which has a stress but no energy"
                raise bad_value("assembly", "ufl", accepted)
        super().__init__(V, element, regions, Q, pressure_scale)
        self._u = _dolfinx.function(V, "u")
        self._p = None if Q is None else _dolfinx.function(Q, "p")
        self._mean: MeanJ | None = None
        kinematics = element.kinematics
        F = ufl.variable(ufl.Identity(3) + displacement_gradient(self._u, kinematics))
        cells = [region.cells for region in regions]
        measures = _dolfinx.cell_measures(V.mesh, cells, element.cell, element.quadrature)
        measures = [of_the_body(kinematics, V.mesh, dx) for dx in measures]
        if any(region.fractions is not None for region in regions):
            fraction = cell_constant(V.mesh, regions, [1.0] * len(regions))
            measures = [WeightedMeasure(fraction, dx) for dx in measures]
        materials = [region.material.expression for region in regions]
        if element.volume == "pointwise":
            densities = [energy_density(m, F) for m in materials]
        else:
            parts = [split(m, BOUNDS[element.volume]) for m in materials]
            densities = [energy_density(part.deviatoric, F) for part in parts]
            if self._p is not None:
                self._origin = _dolfinx.function(Q, "origin")
                self._ratio = _dolfinx.constant(V.mesh, np.array(0.0))
                p, w, s = pressure_scale * self._p, pressure_scale * self._origin, self._ratio
                elastic = (p + s * w) / (1 + s)
                duals = [_in_ufl(part, PRESSURE, part.dual_curve[0], elastic) for part in parts]
                densities = [
                    psi + p * ufl.det(F) - (1 + s) * dual
                    for psi, dual in zip(densities, duals, strict=True)
                ]
        energy = form = sum(psi * dx for psi, dx in zip(densities, measures, strict=True))
        if element.volume == "mean":
            self._mean = MeanJ(self._u, kinematics, measures)
            J = ufl.variable(self._mean.J)
            for part, dx in zip(parts, measures, strict=True):
                U = _in_ufl(part, MEASURES["J"], part.volume_curve[0], J)
                energy += U * dx
                form += ufl.diff(U, J) * ufl.det(F) * dx
        self._energy = _dolfinx.form(energy)
        self._residuals = [
            _dolfinx.form(ufl.derivative(form, f, ufl.TestFunction(f.function_space)))
            for f in (self._u, self._p)
            if f is not None
        ]

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy [J]; +inf where u is outside the energy's domain. Collective."""
        self._set_state(u, p)
        energy = _dolfinx.assemble_scalar(self._energy)
        return float("inf") if isnan(energy) else energy

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add dE/du [N] and dE/dp to all entries of ``r_u`` and ``r_p``, ghosts included."""
        self._set_state(u, p)
        for r, form in zip((r_u, r_p), self._residuals, strict=False):
            _dolfinx.add_vector(r, form)

    def set_viscosity(self, ratio: float = 0.0, origin: Array | None = None) -> None:
        """Set the viscous part of an unknown pressure: see `Elastic.set_viscosity`."""
        super().set_viscosity(ratio, origin)
        self._ratio.value = ratio
        if origin is not None:
            self._origin.x.array[:] = origin

    def _set_state(self, u: PETSc.Vec, p: PETSc.Vec | None) -> None:
        for function, vector in ((self._u, u), (self._p, p)):
            if function is not None and vector is not None:
                copy_to_function(vector, function)
        if self._mean:
            self._mean.update()


def _in_ufl(part: Split, symbol: sympy.Symbol, expression: sympy.Expr, value: Any) -> Any:
    """Return an expression of a symbol and a part's constants in UFL."""
    call = sympy.lambdify((symbol, *part.energy.constants), expression, modules=FUNCTIONS)
    return call(value, *part.energy.values)
