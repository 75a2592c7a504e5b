r"""The volume between a deformed surface and a fixed point: the potential of a uniform pressure.

A pressure p on a surface has the virtual work

.. math:: R(u; v) = p \int_\Gamma \mathrm{cof}(F) N \cdot v \, \mathrm{d}A

(Bonet & Wood 2008, section 8.5). With x = X + u and a point c,

.. math:: S(u) = \frac13 \int_\Gamma (x - c) \cdot \mathrm{cof}(F) N \, \mathrm{d}A

has the derivative R/p but for an integral over the surface's edge, which is linear in x - c. The
integral vanishes where the surface is closed, where its edge is constrained, and where each part of
the edge stays in a plane through c that is a plane of symmetry. Only then is the pressure
conservative, with the energy p S. `fit_points` finds out.

In the plane S is an area, with 1/2 in place of 1/3. On a body of revolution it is the volume
between the surface and the axis, :math:`\int \pi r^2 \, \mathrm{d}z` along the deformed curve, and
needs no point; the pressure is conservative where the curve's ends are on the axis or do not move
along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.ghosted_vectors import copy_to_function, update_ghosts
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.mesh.mesh import volume as body_volume
from fem_snh.terms.body import displacement_gradient

Array = npt.NDArray[Any]

#: Loads at which the derivatives are compared, each with another displacement: the point must be
#: the same for all, so that a moving plane of symmetry is no reason for an energy.
_LOADS = (0.0, 0.5, 1.0)
#: Amplitude and wave vectors of these displacements, in lengths of the body: large enough for
#: cof(F) to be nonlinear, without a symmetry.
_AMPLITUDE, _WAVES = 0.1, np.array([[2.0, 5, 3], [3, 1, 4], [5, 3, 2]])
#: Phases of the waves, and their change from load to load.
_PHASES, _SHIFT = np.array([0.3, 1.1, 2.5]), 1.0
#: Largest difference of the derivatives, relative to them, that counts as rounding, of 1e-14. An
#: edge that contributes makes a difference of about one cell's part.
_ROUNDING = 1e-9


class SweptVolume:
    """The volume S between a deformed surface and a point, and its derivative. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    ds : UFL measure
        The surface.
    kinematics : Kinematics, optional
        How the displacement becomes a deformation gradient.

    Attributes
    ----------
    at_rest : float
        S(0) [m^3] with the point that was set last.
    """

    def __init__(self, V: Any, ds: Any, kinematics: Kinematics = SOLID) -> None:
        # The integrands are polynomials of this degree in each direction of a facet.
        degree = 3 * max(_dolfinx.degree(V), _dolfinx.geometry_degree(V.mesh)) - 1
        self._ds, self.V = ds(metadata={"quadrature_degree": degree}), V
        self._u = _dolfinx.function(V, "displacement")
        self._kinematics, self._X = kinematics, ufl.SpatialCoordinate(V.mesh)
        self._point = _dolfinx.constant(V.mesh, np.zeros(kinematics.dim))
        if kinematics.revolved:
            self._form = self._around_axis(self._u) * self._ds
        else:
            x = self._X + self._u
            normal = self._normal(self._u)
            self._form = ufl.inner(x - self._point, normal) / kinematics.dim * self._ds
        self._compiled = _dolfinx.form(self._form)
        self.at_rest = 0.0

    @property
    def volume_dimension(self) -> int:
        """The power of a length that S is."""
        return self._kinematics.volume_dimension

    def residual(self, u: Any) -> Any:
        """Return the UFL form of the integral of cof(F) N . v [m^2], v a test function."""
        density = ufl.inner(self._normal(u), ufl.TestFunction(self.V))
        if self._kinematics.revolved:
            density *= 2 * ufl.pi * self._X[0]
        return density * self._ds

    def set_point(self, point: Array) -> None:
        """Set the point c [m]. Collective."""
        self._point.value[:] = point
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
            What is constrained: there nothing is compared, and the results are zero.

        Returns
        -------
        residual : (n,)
            The residual.
        missing : (n,)
            The residual minus the derivative for c = 0.
        change : (n, dim)
            Change of the derivative with each component of c.
        """
        derivative = _dolfinx.form(ufl.derivative(self._form, self._u, ufl.TestFunction(self.V)))
        residual, vector = _dolfinx.form(self.residual(self._u)), _dolfinx.create_vector(self.V)

        def assemble(form: Any, point: Array) -> Array:
            self._point.value[:] = point
            _dolfinx.assemble_vector(vector, form)
            values = np.array(vector.array_r)
            dirichlet.project(values)
            return values

        rows = []
        for u in states:
            copy_to_function(u, self._u)
            zero = np.zeros(self._kinematics.dim)
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


def fit_points(
    volumes: Sequence[SweptVolume], pressures: Sequence[float], dirichlet: Dirichlet
) -> Array | None:
    """Return points with which pressures are conservative, (n, dim) [m]. Collective.

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
    (n, dim) array or None
        None if no points make the pressures conservative.
    """
    V = volumes[0].V
    dim = _dolfinx.mesh_dimension(V.mesh)[0]
    length = body_volume(V.mesh) ** (1 / dim)
    states = _states(V, dirichlet, length)
    found = [(p, *v.compare(states, dirichlet)) for p, v in zip(pressures, volumes, strict=True)]
    columns = [length * p * change for p, _, _, change in found]
    missing = np.sum([p * column for p, _, column, _ in found], axis=0)
    sizes = np.stack([p * residual for p, residual, _, _ in found], axis=1)
    # The triangular factor has the norms and the products of all columns, on all ranks together.
    table = np.concatenate([*columns, missing[:, None], sizes], axis=1)
    factors = V.mesh.comm.allgather(np.linalg.qr(table, mode="r"))
    R = np.concatenate(factors)
    A, b, size = R[:, : dim * len(found)], R[:, dim * len(found)], np.abs(R[:, -len(found) :])
    scale = np.sqrt((size**2).sum())
    if scale == 0.0:
        return np.zeros((len(found), dim))
    U, values, W = np.linalg.svd(A, full_matrices=False)
    kept = values > _ROUNDING * scale
    points = (W[kept].T / values[kept]) @ (U[:, kept].T @ b)
    fits = np.linalg.norm(A @ points - b) <= _ROUNDING * scale
    return length * points.reshape(-1, dim) if fits else None


def enclosed_volume(volume: SweptVolume, point: Array, dirichlet: Dirichlet) -> float | None:
    """Return the volume that a surface encloses at rest [m^3], of which its normals point out.

    Collective. The point of ``volume`` is then ``point``.

    Parameters
    ----------
    volume : SweptVolume
        The surface.
    point : (dim,)
        The point of `fit_points` [m].
    dirichlet : Dirichlet
        The constrained dofs.

    Returns
    -------
    float or None
        None if the surface is open elsewhere than in planes of symmetry through the point: then
        the volume depends on directions in which the point is arbitrary.
    """
    V = volume.V
    dim = _dolfinx.mesh_dimension(V.mesh)[0]
    length = body_volume(V.mesh) ** (1 / dim)
    size, _, change = volume.compare(_states(V, dirichlet, length), dirichlet)
    table = np.concatenate([length * change, size[:, None]], axis=1)
    R = np.concatenate(V.mesh.comm.allgather(np.linalg.qr(table, mode="r")))
    _, values, directions = np.linalg.svd(R[:, :dim])
    volume.set_point(point)
    found: float | None = volume.at_rest
    at_rest = volume.at_rest
    for value, direction in zip(values, directions, strict=True):
        if value <= _ROUNDING * np.linalg.norm(R[:, dim]):
            volume.set_point(point + length * direction)
            if abs(volume.at_rest - at_rest) > _ROUNDING * length**volume.volume_dimension:
                found = None
                break
    volume.set_point(point)
    return found


def _states(V: Any, dirichlet: Dirichlet, length: float) -> list[PETSc.Vec]:
    """Return smooth displacements without a symmetry, with the boundary values of some loads."""
    X = V.tabulate_dof_coordinates() / length
    states = []
    for number, load in enumerate(_LOADS):
        u = _dolfinx.create_vector(V)
        waves = _AMPLITUDE * length * np.sin(X @ _WAVES + _PHASES + _SHIFT * number)
        waves = waves[:, : _dolfinx.num_components(V)]
        u.array[:] = waves.ravel()[: u.getLocalSize()]
        dirichlet.set_values(u, load)
        update_ghosts(u)
        states.append(u)
    return states
