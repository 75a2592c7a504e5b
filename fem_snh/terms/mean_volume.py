r"""A volume energy that a program gives, as a function of J or of its mean in each cell.

.. math:: E = \sum_c V_c\, U(\bar J_c), \quad \bar J_c = \frac{1}{V_c} \int_c \det F \, \mathrm{d}V

With :math:`g_c` the derivative of the integral by u, residual and Hessian are

.. math:: \sum_c U' g_c, \quad \sum_c U' \frac{\partial g_c}{\partial u} + \frac{U''}{V_c} g_c g_c^T

(Nagtegaal, Parks & Rice 1974; Bonet & Wood 2008, section 8.6.5): forms of UFL with the mean as a
coefficient, and an outer product in each cell.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isnan
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.elements import Element
from fem_snh.assembly.unknowns import copy_to_function
from fem_snh.errors import bad_value
from fem_snh.kernels.cell_matrices import filter_matrices
from fem_snh.terms.body import displacement_gradient, of_the_body
from fem_snh.terms.term import Term
from fem_snh.terms.ufl_term import UFLTerm, compile_form

#: U(J) [Pa], of a UFL expression J.
VolumeEnergy = Callable[[Any], Any]
_NAME = "volume"


def volume_term(energy: VolumeEnergy, u: Any, element: Element, depends_on_load: bool) -> Any:
    """Return the term of a volume energy U, of J or, as ``element.volume`` says, of its mean.

    Raises
    ------
    BadInput
        If ``energy`` is not callable, in plane stress, and for an element with unknown pressures.
    """
    if not callable(energy):
        raise bad_value("volume", energy, "a function of J, U(J) [Pa]")
    if element.volume not in ("pointwise", "mean") or element.kinematics.plane_stress:
        accepted = "no function, in plane stress and with an element that has unknown pressures"
        raise bad_value("volume", getattr(energy, "__name__", "U"), accepted)
    if element.volume == "mean":
        return MeanVolume(energy, u, element, depends_on_load)
    dx = ufl.dx(metadata={"quadrature_degree": element.quadrature})
    measure = of_the_body(element.kinematics, u.function_space.mesh, dx)
    J = ufl.det(ufl.Identity(3) + displacement_gradient(u, element.kinematics))
    return UFLTerm(energy(J) * measure, u, _NAME, depends_on_load)


class MeanVolume(Term):
    """The energy U of the mean of J in each cell, integrated over the cells. Collective.

    Parameters
    ----------
    energy : callable
        U(J) [Pa], of a UFL expression J.
    u : dolfinx Function
        The displacement.
    element : Element
        The element, for quadrature and kinematics.
    depends_on_load : bool
        Whether a program sets constants in U for a load.
    """

    name, has_energy, stateless = _NAME, True, True

    def __init__(
        self, energy: VolumeEnergy, u: Any, element: Element, depends_on_load: bool
    ) -> None:
        V, self.depends_on_load = u.function_space, depends_on_load
        domain, kinematics = V.mesh, element.kinematics
        dx = of_the_body(
            kinematics, domain, ufl.dx(metadata={"quadrature_degree": element.quadrature})
        )
        cells = _dolfinx.function_space(domain, 0, family="DG")
        self._dofs = _dolfinx.node_dofs(cells)[:, 0]
        self._mean, self._u = _dolfinx.function(cells, "mean_J"), _dolfinx.function(V, "u")
        self._sums = _dolfinx.create_vector(cells)
        q, v, J = ufl.TestFunction(cells), ufl.TestFunction(V), ufl.variable(self._mean)
        slope = ufl.diff(energy(J), J)

        def det(w: Any) -> Any:
            return ufl.det(ufl.Identity(3) + displacement_gradient(w, kinematics))

        def compiled(form: Any) -> Any:
            return compile_form(ufl.algorithms.expand_derivatives(form), _NAME)

        self._det = compiled(det(self._u) * q * dx)
        self._energy = compiled(energy(self._mean) * dx)
        self._stiffness = compiled(ufl.diff(slope, J) * q * dx)
        self._assemble(compiled(1.0 * q * dx))
        self._volumes = self._sums.array.copy()
        self._force = UFLTerm(slope * ufl.derivative(det(u), u, v) * dx, u, _NAME)
        # The derivative of this form by u has g_c as its columns of one component, summed: the
        # shape functions have the sum 1.
        change = ufl.derivative(det(self._u), self._u, v)
        self._columns = UFLTerm(u[0] * change * dx, u, _NAME)
        self._components = _dolfinx.num_components(V)

    def _assemble(self, form: Any) -> Any:
        """Return a DG0 form's values in this rank's own cells; the next call overwrites them."""
        _dolfinx.assemble_vector(self._sums, form)
        return self._sums.array

    def _set(self, u: PETSc.Vec) -> None:
        """Copy ``u`` to the forms' displacement, and set the mean of J in each cell. Collective."""
        copy_to_function(u, self._u)
        means = self._assemble(self._det) / self._volumes
        self._mean.x.array[: len(means)] = means
        self._mean.x.scatter_forward()

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy [J]; +inf if U is NaN in any cell. Collective."""
        self._set(u)
        energy = _dolfinx.assemble_scalar(self._energy)
        return float("inf") if isnan(energy) else energy

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to all entries of ``r_u``, ghosts included. Collective."""
        self._set(u)
        self._force.add_residual(u, p, r_u, r_p)

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the Hessian [N/m], filtered by cells: see `Term.add_hessian`. Collective."""
        self._set(u)
        factors = (self._assemble(self._stiffness) / self._volumes**2).copy()
        count = 0
        both = zip(
            self._force.element_matrices(u, "exact", symmetric=True),
            self._columns.element_matrices(u, "exact", symmetric=False),
            strict=True,
        )
        for (cells, matrices, _), (_, columns, _) in both:
            g = columns[:, :, :: self._components].sum(axis=2)
            outer = factors[self._dofs[cells], None, None] * g[:, :, None] * g[:, None, :]
            whole, filtered = filter_matrices(matrices + outer, filter)
            target.add_matrices(cells, np.ascontiguousarray(whole))
            count += filtered
        return count
