r"""The volume that a deformed surface encloses: the potential of a uniform pressure.

A pressure p on a surface has the virtual work

.. math:: R(u; v) = p \int_\Gamma \mathrm{cof}(F) N \cdot v \, \mathrm{d}A

(Bonet & Wood 2008, section 8.5). With x = X + u, the flux of an affine field f of divergence 1,

.. math:: S(u) = \int_\Gamma f(x) \cdot \mathrm{cof}(F) N \, \mathrm{d}A, \quad
    f(x) = A (x - o) + b, \quad \mathrm{tr} A = 1,

is the enclosed volume by the divergence theorem. It has the derivative R/p but for an integral over
the surface's edge, which is linear in f. The integral vanishes where the surface is closed, where
its edge is constrained, and where each part of the edge stays in a plane of symmetry that f does
not cross. Only then is the pressure conservative, with the energy p S. `fit_fields` finds out. Of
one plane, or of three that meet in a point c, the field is (x - c)/3, and S the volume of the cone
between the surface and c; of a tube between two parallel planes the field has no component along
the axis.

In the plane S is an area. On a body of revolution it is the volume between the surface and the
axis, :math:`\int \pi r^2 \, \mathrm{d}z` along the deformed curve, and needs no field; the pressure
is conservative where the curve's ends are on the axis or do not move along it.

A rigid part that has an edge of the surface closes it by a lid (`fem_snh.terms.closing_surface`),
whose work R lacks. With its vector area a and its moment M at rest about a point X of the part,
which moves to x, the flux through the lid is

.. math:: f(x) \cdot R a + A : R M R^T, \quad M = \int N (Y - X)^T \, \mathrm{d}A .

The mean over the part's facets, where F = R along them and cof(F) N = R N, has local derivatives.
Where the part's own conditions keep it in a plane of symmetry they are not the forces on the lid:
the work of the pressure is :math:`R a \cdot v + \delta R : R M`, without the field. On a body of
revolution :math:`\pi r^2 \, \mathrm{d}z` is zero along a lid, and the work is that on a disc.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from math import ceil
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import estimate_total_polynomial_degree, expand_derivatives

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.unknowns import copy_to_function, update_ghosts
from fem_snh.mesh.mesh import volume as body_volume
from fem_snh.terms.body import displacement_gradient
from fem_snh.terms.closing_surface import ClosingSurface, Fan, NotClosedError

Array = npt.NDArray[Any]

#: Loads at which the derivatives are compared, each with another displacement: the field must be
#: the same for all, so that a moving plane is a reason for an energy only if no field crosses it.
_LOADS = (0.0, 0.5, 1.0)
#: Least number of equations over that of parameters: few nodes have further displacements.
_OVERDETERMINED = 2
#: Amplitude and wave vectors of these displacements, in lengths of the body: large enough for
#: cof(F) to be nonlinear, without a symmetry.
_AMPLITUDE, _WAVES = 0.1, np.array([[2.0, 5, 3], [3, 1, 4], [5, 3, 2]])
#: Phases of the waves, and their change from load to load.
_PHASES, _SHIFT = np.array([0.3, 1.1, 2.5]), 1.0
#: Largest difference of the derivatives, relative to them, that counts as rounding, of 1e-14. An
#: edge that contributes makes a difference of about one cell's part.
_ROUNDING = 1e-9


class SweptVolume:
    """The volume S that a deformed surface encloses, and its derivative. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    ds : UFL measure
        The surface.
    kinematics : Kinematics, optional
        How the displacement becomes a deformation gradient.
    closing : ClosingSurface, optional
        What closes the surface: then the field is its field, and S the enclosed volume.

    Attributes
    ----------
    at_rest : float
        S(0) [m^3] with the field that was set last.
    length : float
        A length of the body [m].
    """

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        ds: Any,
        kinematics: Kinematics = SOLID,
        closing: ClosingSurface | None = None,
    ) -> None:
        # The integrands are polynomials of this degree in each direction of a facet.
        self._degree = 3 * max(_dolfinx.degree(V), _dolfinx.geometry_degree(V.mesh)) - 1
        rule = {"metadata": {"quadrature_degree": self._degree}}
        groups = [_dolfinx.measure_entities(ds, V.mesh)]
        self._closing, lids = closing, closing.lids if closing else {}
        groups += [closing.facets_of_part(part, groups[0]) for part in lids] if closing else []
        self._lids: list[tuple[Fan, float, Any]] = []
        self._ds, *on_parts = (m(**rule) for m in _dolfinx.surface_measures(V.mesh, groups))
        self.V = V
        self._u = _dolfinx.function(V, "displacement")
        self._kinematics, self._X = kinematics, ufl.SpatialCoordinate(V.mesh)
        dim = kinematics.dim
        self._A = _dolfinx.constant(V.mesh, np.eye(dim) / dim)
        self._b = _dolfinx.constant(V.mesh, np.zeros(dim))
        self.length = body_volume(V.mesh) ** (1 / dim)
        if kinematics.revolved:
            self._form = self._around_axis(self._u) * self._ds
        else:
            # Far from the coordinates' origin rounding would be that of the distance.
            self._centre = _centre(V.mesh)[:dim]
            self._from_centre = self._X - _dolfinx.constant(V.mesh, self._centre)
            self._field = ufl.dot(self._A, self._from_centre + self._u) + self._b
            self._form = ufl.inner(self._field, self._normal(self._u)) * self._ds
        self._add_lids(lids, on_parts)
        self.at_rest = 0.0
        self._compiled = _dolfinx.form(self._form)
        if closing and not kinematics.revolved:
            self._A.value[:], self._b.value[:] = closing.field(self._centre)
        if closing:
            self.at_rest = self._flux()

    @property
    def volume_dimension(self) -> int:
        """The power of a length that S is."""
        return self._kinematics.volume_dimension

    def residual(self, u: Any, value: Any = 1.0) -> Any:
        """Return the UFL form of the integral of value cof(F) N . v, v a test function.

        With the work of the value on lids, where it must not vary.
        """
        density = value * ufl.inner(self._normal(u), ufl.TestFunction(self.V))
        if self._kinematics.revolved:
            density *= 2 * ufl.pi * self._X[0]
        degree = self._degree + estimate_total_polynomial_degree(ufl.as_ufl(value))
        form = density * self._ds(metadata={"quadrature_degree": degree})
        return form + value * self._work_on_lids(u) if self._lids else form

    def _on_lids(self, u: Any, integrand: Callable[[Any, Any, Any], Any]) -> Any:
        """Return the mean of an integrand over the facets of each lid's part, and their sum.

        It is a function of R, a and M, in UFL.
        """
        domain, dim, total = self.V.mesh, self._kinematics.dim, 0
        N, unit = ufl.FacetNormal(domain), ufl.Identity(dim)
        R = unit
        if not self._kinematics.revolved:  # F N is not R N
            along = ufl.dot(unit + ufl.grad(u), unit - ufl.outer(N, N))
            R = along + ufl.outer(self._normal(u), N)
        for fan, size, ds in self._lids:
            area = _dolfinx.constant(domain, fan.area / size)
            arm = self._X - _dolfinx.constant(domain, fan.apex)
            moment = _dolfinx.constant(domain, fan.moment / size) - ufl.outer(area, arm)
            total += integrand(R, area, moment) * ds
        return total

    def _add_lids(self, lids: Mapping[int, Fan], measures: Sequence[Any]) -> None:
        """Add the flux through lids of rigid parts. Collective."""
        one = _dolfinx.constant(self.V.mesh, 1.0)
        for (part, fan), ds in zip(lids.items(), measures, strict=True):
            size = _dolfinx.assemble_scalar(_dolfinx.form(one * ds))
            if not size:
                raise NotClosedError(f"rigid part {part + 1} has no other facets of the boundary")
            self._lids.append((fan, size, ds))
        if not self._kinematics.revolved:

            def flux(R: Any, area: Any, moment: Any) -> Any:
                quadratic = ufl.inner(self._A, ufl.dot(ufl.dot(R, moment), ufl.transpose(R)))
                return ufl.dot(self._field, ufl.dot(R, area)) + quadratic

            self._form += self._on_lids(self._u, flux)

    def _work_on_lids(self, u: Any) -> Any:
        """Return the UFL form of the work of a unit pressure on the lids."""
        v, dim = ufl.TestFunction(self.V), self._kinematics.dim
        ahead = ufl.as_vector([v[i] for i in range(dim)])

        def work(R: Any, area: Any, moment: Any) -> Any:
            if self._kinematics.revolved:
                return ufl.dot(area, ahead)
            turned = expand_derivatives(ufl.derivative(R, u, v))
            return ufl.dot(ufl.dot(R, area), ahead) + ufl.inner(turned, ufl.dot(R, moment))

        return self._on_lids(u, work)

    def derivative(self, u: Any) -> Any:
        """Return the UFL form of the derivative of S."""
        form = ufl.derivative(self._form, self._u, ufl.TestFunction(self.V))
        return ufl.replace(expand_derivatives(form), {self._u: u})

    @property
    def num_parameters(self) -> int:
        """The number of parameters of the field; 0 on a body of revolution."""
        return (
            0 if self._kinematics.revolved else self._kinematics.dim**2 - 1 + self._kinematics.dim
        )

    def _choose_field(self, parameters: Array) -> None:
        """Set A, by its part of trace 0, and b, in lengths of the body."""
        if not self.num_parameters:
            return
        dim = self._kinematics.dim
        # The last entry of the diagonal follows from the trace.
        entries = np.append(parameters[: dim**2 - 1], 0.0).reshape(dim, dim)
        entries[-1, -1] = -np.trace(entries)
        self._A.value[:] = np.eye(dim) / dim + entries
        self._b.value[:] = self.length * parameters[dim**2 - 1 :]

    def set_field(self, parameters: Array) -> None:
        """Set the field f by its parameters, (num_parameters,). Collective."""
        self._choose_field(parameters)
        self.at_rest = self._flux()

    def _flux(self, u: PETSc.Vec | None = None) -> float:
        """Return S at a displacement or, by default, at rest."""
        if u is None:
            self._u.x.array[:] = 0.0
        else:
            copy_to_function(u, self._u)
        flux = _dolfinx.assemble_scalar(self._compiled)
        if self._closing and not self._kinematics.revolved:
            flux += self._closing.flux(self._A.value, self._b.value, self._centre, u)
        return flux

    def change(self, u: PETSc.Vec) -> float:
        """Return S(u) - S(0) [m^3]. Collective."""
        return self._flux(u) - self.at_rest

    def compare(
        self, states: Sequence[PETSc.Vec], dirichlet: Dirichlet
    ) -> tuple[Array, Array, Array]:
        """Compare the derivative of S with the residual, at this rank's dofs. Collective.

        Parameters
        ----------
        states : sequence of PETSc.Vec
            Ghosted displacements; the results are those of one state after the other.
        dirichlet : Dirichlet
            What is constrained: there the results are zero.

        Returns
        -------
        residual : (n,)
            The residual.
        missing : (n,)
            The residual minus the derivative for parameters 0, of f = (x - o)/dim.
        change : (n, num_parameters)
            Change of the derivative with each parameter of f.
        """
        derivative = _dolfinx.form(self.derivative(self._u))
        residual, vector = _dolfinx.form(self.residual(self._u)), _dolfinx.create_vector(self.V)

        def assemble(form: Any, parameters: Array) -> Array:
            self._choose_field(parameters)
            _dolfinx.assemble_vector(vector, form)
            values = np.array(vector.array_r)
            dirichlet.project(values)
            return values

        rows = []
        for u in states:
            copy_to_function(u, self._u)
            zero = np.zeros(self.num_parameters)
            wanted, origin = assemble(residual, zero), assemble(derivative, zero)
            change = [assemble(derivative, unit) - origin for unit in np.eye(len(zero))]
            rows.append(np.stack([wanted, wanted - origin, *change], axis=1))
        table = np.concatenate(rows)
        return table[:, 0], table[:, 1], table[:, 2:]

    def _normal(self, u: Any) -> Any:
        """cof(F) N, without a division by det F."""
        kinematics = self._kinematics
        F = ufl.Identity(3) + displacement_gradient(u, kinematics)
        a, b, c = (ufl.as_vector([F[i, k] for i in range(3)]) for k in range(3))
        N = ufl.FacetNormal(self.V.mesh)
        if kinematics.dim == 3:
            return N[0] * ufl.cross(b, c) + N[1] * ufl.cross(c, a) + N[2] * ufl.cross(a, b)
        normal = N[0] * ufl.cross(b, c) + N[1] * ufl.cross(c, a)
        return ufl.as_vector([normal[i] for i in range(kinematics.components)])

    def _around_axis(self, u: Any) -> Any:
        """pi r^2 dz/ds of a deformed curve, r the distance from the axis."""
        squares = (self._X[0] + u[0]) ** 2
        if self._kinematics.components == 3:
            squares += u[2] ** 2
        N, H = ufl.FacetNormal(self.V.mesh), ufl.grad(u)
        return ufl.pi * squares * ((1 + H[1, 1]) * N[0] - H[1, 0] * N[1])


def fit_fields(
    volumes: Sequence[SweptVolume], pressures: Sequence[float], dirichlet: Dirichlet
) -> Array | None:
    """Return parameters of fields with which pressures are conservative. Collective.

    The least-squares fit of the derivatives to the residuals at several displacements.

    Parameters
    ----------
    volumes : sequence of n SweptVolume
        The surfaces, on one space.
    pressures : sequence of n floats
        The pressures on them [Pa], which vary in proportion.
    dirichlet : Dirichlet
        The constrained dofs, at which forces do no work.

    Returns
    -------
    (n, num_parameters) array or None
        None if no fields make the pressures conservative.
    """
    comm, size = volumes[0].V.mesh.comm, volumes[0].num_parameters
    unknowns = size * len(volumes)
    table = _compare_all(volumes, pressures, dirichlet, len(_LOADS))
    # On few free nodes there are fewer equations than parameters, which fulfil any of them.
    largest = comm.allreduce(float(np.abs(table).max(initial=0.0)), op=MPI.MAX)
    is_equation = (np.abs(table[:, : unknowns + 1]) > _ROUNDING * largest).any(axis=1)
    equations = comm.allreduce(int(is_equation.sum()))
    if 0 < equations < _OVERDETERMINED * unknowns:
        more = ceil(_OVERDETERMINED * unknowns / equations)
        table = _compare_all(volumes, pressures, dirichlet, more * len(_LOADS))
    # The triangular factor has the norms and the products of all columns, on all ranks together.
    R = np.concatenate(comm.allgather(np.linalg.qr(table, mode="r")))
    A, b = R[:, :unknowns], R[:, unknowns]
    scale = np.linalg.norm(R[:, unknowns + 1 :])
    if scale == 0.0:
        return np.zeros((len(volumes), size))
    U, values, W = np.linalg.svd(A, full_matrices=False)
    kept = values > _ROUNDING * scale
    parameters = (W[kept].T / values[kept]) @ (U[:, kept].T @ b)
    fits = np.linalg.norm(A @ parameters - b) <= _ROUNDING * scale
    return parameters.reshape(len(volumes), size) if fits else None


def _compare_all(
    volumes: Sequence[SweptVolume], pressures: Sequence[float], dirichlet: Dirichlet, count: int
) -> Array:
    """Return the equations of `fit_fields` at some displacements: a row for each owned dof.

    Collective. The columns are the changes with the parameters of each surface, what is missing,
    and the residual of each surface.
    """
    states = _states(volumes[0].V, dirichlet, count)
    found = [(p, *v.compare(states, dirichlet)) for p, v in zip(pressures, volumes, strict=True)]
    columns = [p * change for p, _, _, change in found]
    missing = np.sum([p * column for p, _, column, _ in found], axis=0)
    sizes = np.stack([p * residual for p, residual, _, _ in found], axis=1)
    return np.concatenate([*columns, missing[:, None], sizes], axis=1)


def _centre(domain: _dolfinx.Mesh) -> Array:
    """Return the centre of the bounding box of the nodes (3,) [m]. Collective."""
    boxes = domain.comm.allgather(_dolfinx.bounding_box(domain))
    return (np.min(boxes, axis=0)[0] + np.max(boxes, axis=0)[1]) / 2


def _states(
    V: _dolfinx.FunctionSpace, dirichlet: Dirichlet, count: int = len(_LOADS)
) -> list[PETSc.Vec]:
    """Return smooth displacements without a symmetry, with the boundary values of some loads."""
    length = body_volume(V.mesh) ** (1 / _dolfinx.mesh_dimension(V.mesh)[0])
    X = V.tabulate_dof_coordinates() / length
    states = []
    for number, load in zip(range(count), cycle(_LOADS), strict=False):
        u = _dolfinx.create_vector(V)
        waves = _AMPLITUDE * length * np.sin(X @ _WAVES + _PHASES + _SHIFT * number)
        waves = waves[:, : _dolfinx.num_components(V)]
        u.array[:] = waves.ravel()[: u.getLocalSize()]
        dirichlet.set_values(u, load)
        update_ghosts(u)
        states.append(u)
    return states
