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

A rigid part that has an edge of the surface closes it by a lid, whose work R lacks. There
x = R X + c, and with :math:`f = (x - o)/n` in n dimensions the flux through the lid is, but for a
constant, :math:`f(x) \cdot R a` at any point x of the part, a the lid's vector area. The mean over
the part's facets, where F = R along them and cof(F) N = R N, has local derivatives. On a body of
revolution :math:`\pi r^2 \, \mathrm{d}z` is zero along a lid. The forces at the parts' nodes are
those of S.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, cycle
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
from fem_snh.assembly.ghosted_vectors import copy_to_function, update_ghosts
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.mesh.mesh import volume as body_volume
from fem_snh.terms.body import displacement_gradient

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
    parts : (local nodes,) int, optional
        Which rigid part has each node, -1: none. They are lids of the surface.

    Attributes
    ----------
    at_rest : float
        S(0) [m^3] with the field that was set last.
    length : float
        A length of the body [m].
    has_open_lids : bool
        Whether planes of symmetry must close some lids: f must be zero in them.
    lid_dofs : (n,) int
        The local dofs of lids, at which the forces are the derivative of S.
    """

    def __init__(
        self, V: Any, ds: Any, kinematics: Kinematics = SOLID, parts: Array | None = None
    ) -> None:
        # The integrands are polynomials of this degree in each direction of a facet.
        self._degree = 3 * max(_dolfinx.degree(V), _dolfinx.geometry_degree(V.mesh)) - 1
        rule = {"metadata": {"quadrature_degree": self._degree}}
        groups = [_dolfinx.measure_entities(ds, V.mesh)]
        groups += [] if parts is None else _facets_of_parts(V, parts, kinematics, groups[0])
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
            x = self._X - _dolfinx.constant(V.mesh, _centre(V.mesh)[:dim])
            self._field_at_rest = ufl.dot(self._A, x) + self._b
            self._field = self._field_at_rest + ufl.dot(self._A, self._u)
            self._form = ufl.inner(self._field, self._normal(self._u)) * self._ds
        self._lids: list[tuple[Any, list[Any], float]] = []
        self.lid_dofs, self.has_open_lids = np.empty(0, np.int64), False
        if parts is not None:
            self._add_lids(parts, on_parts)
        self._compiled = _dolfinx.form(self._form)
        self.at_rest = 0.0

    @property
    def volume_dimension(self) -> int:
        """The power of a length that S is."""
        return self._kinematics.volume_dimension

    def residual(self, u: Any, value: Any = 1.0) -> Any:
        """Return the UFL form of the integral of value cof(F) N . v, v a test function."""
        density = value * ufl.inner(self._normal(u), ufl.TestFunction(self.V))
        if self._kinematics.revolved:
            density *= 2 * ufl.pi * self._X[0]
        degree = self._degree + estimate_total_polynomial_degree(ufl.as_ufl(value))
        return density * self._ds(metadata={"quadrature_degree": degree})

    def _add_lids(self, parts: Array, measures: Sequence[Any]) -> None:
        """Add the flux through the lids by rigid parts with an edge of the surface. Collective.

        ``measures`` are those of `_facets_of_parts`.
        """
        V, dim, domain = self.V, self._kinematics.dim, self.V.mesh
        if self._kinematics.revolved:
            self.lid_dofs = np.flatnonzero(np.repeat(parts >= 0, self._kinematics.components))
            return
        N, Y, H = ufl.FacetNormal(domain), dim * self._field_at_rest, ufl.grad(self._u)
        on_lids = np.zeros(len(parts), dtype=bool)
        for part, ds in enumerate(measures):
            inside = _dolfinx.function(V, "lid")
            inside.x.array.reshape(len(parts), -1)[:, 0] = parts == part
            slope = ufl.grad(inside[0])
            # By Stokes's theorem: where the surface is closed it is zero.
            curl = ufl.inner(slope, Y) + (dim - 1) * inside[0]
            areas = [
                _dolfinx.form((ufl.dot(Y, N) * slope[k] - N[k] * curl) / (dim - 1) * self._ds)
                for k in range(dim)
            ]
            one = _dolfinx.constant(domain, 1.0)
            size = _dolfinx.assemble_scalar(_dolfinx.form(one * ds))
            area = [_dolfinx.assemble_scalar(form) for form in areas]
            if not size or np.abs(area).max() <= _ROUNDING * self.length ** (dim - 1):
                continue
            across = [N[i] * slope[k] - N[k] * slope[i] for i, k in combinations(range(dim), 2)]
            ends = [_dolfinx.assemble_scalar(_dolfinx.form(form * self._ds)) for form in across]
            self.has_open_lids |= bool(np.abs(ends).max() > _ROUNDING * self.length ** (dim - 2))
            mean = _dolfinx.constant(domain, np.zeros(dim))  # a over the facets' size
            along = mean - N * ufl.dot(N, mean)
            turned = self._normal(self._u) * ufl.dot(N, mean) + along + ufl.dot(H, along)
            self._form += ufl.inner(self._field, turned) * ds
            self._lids.append((mean, areas, size))
            on_lids |= parts == part
        components = self._kinematics.components
        self.lid_dofs = np.flatnonzero(np.repeat(on_lids, components))

    def derivative(self, u: Any) -> Any:
        """Return the UFL form of the derivative of S."""
        form = ufl.derivative(self._form, self._u, ufl.TestFunction(self.V))
        return ufl.replace(expand_derivatives(form), {self._u: u})

    @property
    def num_parameters(self) -> int:
        """The number of parameters of the field, with lids of b; 0 on a body of revolution."""
        dim = self._kinematics.dim
        return 0 if self._kinematics.revolved else (0 if self._lids else dim**2 - 1) + dim

    def _choose_field(self, parameters: Array) -> None:
        """Set A, by its part of trace 0, and b, in lengths of the body."""
        if not self.num_parameters:
            return
        dim = self._kinematics.dim
        if self._lids:
            parameters = np.concatenate([np.zeros(dim**2 - 1), parameters])
        # The last entry of the diagonal follows from the trace.
        entries = np.append(parameters[: dim**2 - 1], 0.0).reshape(dim, dim)
        entries[-1, -1] = -np.trace(entries)
        self._A.value[:] = np.eye(dim) / dim + entries
        self._b.value[:] = self.length * parameters[dim**2 - 1 :]

    def set_field(self, parameters: Array) -> None:
        """Set the field f by its parameters, (num_parameters,). Collective."""
        self._choose_field(parameters)
        for mean, areas, size in self._lids:
            mean.value[:] = [_dolfinx.assemble_scalar(form) / size for form in areas]
        self._u.x.array[:] = 0.0
        self.at_rest = _dolfinx.assemble_scalar(self._compiled)

    def change(self, u: PETSc.Vec) -> float:
        """Return S(u) - S(0) [m^3]. Collective."""
        copy_to_function(u, self._u)
        return _dolfinx.assemble_scalar(self._compiled) - self.at_rest

    def compare(
        self, states: Sequence[PETSc.Vec], dirichlet: Dirichlet
    ) -> tuple[Array, Array, Array]:
        """Compare the derivative of S with the residual, at this rank's dofs. Collective.

        Parameters
        ----------
        states : sequence of PETSc.Vec
            Ghosted displacements; the results are those of one state after the other.
        dirichlet : Dirichlet
            What is constrained: there the results are zero. On lids nothing is compared, either.

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
            row = np.stack([wanted, wanted - origin, *change], axis=1)
            row[self.lid_dofs[self.lid_dofs < len(row)], 1:] = 0.0
            rows.append(row)
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


def enclosed_volume(volume: SweptVolume, parameters: Array, dirichlet: Dirichlet) -> float | None:
    """Return the volume that a surface encloses at rest [m^3], of which its normals point out.

    Collective. The field of ``volume`` is then that of ``parameters``.

    Parameters
    ----------
    volume : SweptVolume
        The surface.
    parameters : (num_parameters,)
        Those of `fit_fields`.
    dirichlet : Dirichlet
        The constrained dofs.

    Returns
    -------
    float or None
        None if the surface is open elsewhere than in planes of symmetry: then the volume depends
        on parameters of the field that are arbitrary.
    """
    V, size = volume.V, volume.num_parameters
    residual, _, change = volume.compare(_states(V, dirichlet), dirichlet)
    table = np.concatenate([change, residual[:, None]], axis=1)
    R = np.concatenate(V.mesh.comm.allgather(np.linalg.qr(table, mode="r")))
    _, values, directions = np.linalg.svd(R[:, :size])
    volume.set_field(parameters)
    found: float | None = volume.at_rest
    at_rest, unit = volume.at_rest, volume.length**volume.volume_dimension
    for value, direction in zip(values, directions, strict=True):
        if value <= _ROUNDING * np.linalg.norm(R[:, size]):
            volume.set_field(parameters + direction)
            if abs(volume.at_rest - at_rest) > _ROUNDING * unit:
                found = None
                break
    volume.set_field(parameters)
    return found


def _facets_of_parts(V: Any, parts: Array, kinematics: Kinematics, beside: Array) -> list[Array]:
    """Return this rank's facets of each rigid part that are not among others. Collective."""
    if kinematics.revolved:
        return []
    facets, cells, local = _dolfinx.exterior_facets(V.mesh)
    owners = parts[_dolfinx.node_dofs(V)[cells[:, None], _dolfinx.facet_nodes(V)[local]]]
    owners[np.isin(facets, beside)] = -1
    count = V.mesh.comm.allreduce(int(parts.max(initial=-1)) + 1, op=MPI.MAX)
    return [facets[(owners == part).all(axis=1)] for part in range(count)]


def _centre(domain: Any) -> Array:
    """Return the centre of the bounding box of the nodes (3,) [m]. Collective."""
    boxes = domain.comm.allgather(_dolfinx.bounding_box(domain))
    return (np.min(boxes, axis=0)[0] + np.max(boxes, axis=0)[1]) / 2


def _states(V: Any, dirichlet: Dirichlet, count: int = len(_LOADS)) -> list[PETSc.Vec]:
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
