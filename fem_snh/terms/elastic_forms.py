"""The elastic energy by forms that FFCx compiles; the filtered Hessian remains the kernels'."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import Any

from mpi4py import MPI
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

    The residual of the second has the pressure U'(J_e) of each cell as a coefficient.

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
        self._mean: _MeanVolume | None = None
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
            if element.volume == "mean":
                self._mean = _MeanVolume(V.mesh, F, measures, parts, cells)
            densities = [energy_density(part.deviatoric, F) for part in parts]
            if self._p is not None:
                self._origin = _dolfinx.function(Q, "origin")
                self._ratio = _dolfinx.constant(V.mesh, np.array(0.0))
                p, w, s = pressure_scale * self._p, pressure_scale * self._origin, self._ratio
                elastic = (p + s * w) / (1 + s)
                densities = [
                    psi + p * ufl.det(F) - (1 + s) * _dual(part, elastic)
                    for psi, part in zip(densities, parts, strict=True)
                ]
        form = sum(psi * dx for psi, dx in zip(densities, measures, strict=True))
        self._energy = _dolfinx.form(form)
        if self._mean:
            form += sum(self._mean.pressure * ufl.det(F) * dx for dx in measures)
        self._residuals = [
            _dolfinx.form(ufl.derivative(form, f, ufl.TestFunction(f.function_space)))
            for f in (self._u, self._p)
            if f is not None
        ]

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy [J]; +inf where u is outside the energy's domain. Collective."""
        self._set_state(u, p)
        energy = _dolfinx.assemble_scalar(self._energy)
        if self._mean:
            energy += self._mean.energy()
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


def _dual(part: Split, p: Any) -> Any:
    """Return U*(p), the conjugate of the volume term, as a UFL expression."""
    arguments = (PRESSURE, *part.energy.constants)
    call = sympy.lambdify(arguments, part.dual_curve[0], modules=FUNCTIONS)
    return call(p, *part.energy.values)


class _MeanVolume:
    """The mean volume ratio of each cell, its energy and its pressure.

    Attributes
    ----------
    pressure : dolfinx Function
        U'(J_e) [Pa], constant on each cell.
    """

    def __init__(
        self,
        domain: _dolfinx.Mesh,
        F: Any,
        measures: Sequence[Any],
        parts: Sequence[Split],
        cells: Sequence[Array],
    ) -> None:
        space = _dolfinx.function_space(domain, 0, family="DG")
        self.pressure = _dolfinx.function(space, "pressure")
        test = ufl.TestFunction(space)
        self._comm = domain.comm
        self._form = _dolfinx.form(sum(ufl.det(F) * test * dx for dx in measures))
        self._integrals = _dolfinx.create_vector(space)
        dofs = _dolfinx.node_dofs(space)[:, 0]
        self._dofs = [dofs[own] for own in cells]
        volumes = self._integrals.duplicate()
        _dolfinx.assemble_vector(volumes, _dolfinx.form(sum(test * dx for dx in measures)))
        self._volumes = [volumes.array_r[own] for own in self._dofs]
        self._curves = [
            sympy.lambdify((MEASURES["J"], *part.energy.constants), part.volume_curve[:2], "numpy")
            for part in parts
        ]
        self._constants = [part.energy.values for part in parts]
        self._energies: list[Array] = []

    def update(self) -> None:
        """Compute the energies U(J_e) [Pa] and the pressures of the present state. Collective."""
        _dolfinx.assemble_vector(self._integrals, self._form)
        self._energies = []
        integrals = self._integrals.array_r
        for dofs, volumes, curve, constants in zip(
            self._dofs, self._volumes, self._curves, self._constants, strict=True
        ):
            with np.errstate(invalid="ignore", divide="ignore"):  # outside the domain: NaN
                U, pressure = curve(integrals[dofs] / volumes, *constants)
            self._energies.append(U)
            self.pressure.x.array[dofs] = pressure

    def energy(self) -> float:
        """Return the sum of V_e U(J_e) [J] of the state that `update` has seen. Collective."""
        local = sum(float(v @ U) for v, U in zip(self._volumes, self._energies, strict=True))
        return float(self._comm.allreduce(local, op=MPI.SUM))
