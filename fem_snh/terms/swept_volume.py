r"""The volume that a deformed surface encloses: the potential of a uniform pressure.

A pressure p on a surface has the virtual work

.. math:: R(u; v) = p \int_\Gamma \mathrm{cof}(F) N \cdot v \, \mathrm{d}A

(Bonet & Wood 2008, section 8.5). With x = X + u, the flux of an affine field f of divergence 1,

.. math:: S(u) = \int_\Gamma f(x) \cdot \mathrm{cof}(F) N \, \mathrm{d}A, \quad
    f(x) = A (x - o) + b, \quad \mathrm{tr} A = 1,

is the enclosed volume by the divergence theorem, if f crosses nothing of what closes the surface
(`fem_snh.terms.closing_surface`). Then the pressure is conservative, with the energy p S. Of one
plane of symmetry, or of three that meet in a point c, the field is (x - c)/3, and S the volume of
the cone between the surface and c; of a tube between two parallel planes the field has no component
along the axis.

In the plane S is an area. On a body of revolution it is the volume between the surface and the
axis, :math:`\int \pi r^2 \, \mathrm{d}z` along the deformed curve, and needs no field.

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
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import estimate_total_polynomial_degree, expand_derivatives

from fem_snh import _dolfinx
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.unknowns import copy_to_function
from fem_snh.terms.body import displacement_gradient
from fem_snh.terms.closing_surface import ClosingSurface, Fan, NotClosedError

Array = npt.NDArray[Any]


class SweptVolume:
    """The volume S that a deformed surface encloses, and the work of a pressure. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    facets : (n,) int
        This rank's facets of the surface.
    kinematics : Kinematics, optional
        How the displacement becomes a deformation gradient.
    closing : ClosingSurface, optional
        What closes the surface; without it S is unknown.

    Attributes
    ----------
    at_rest : float
        S(0) [m^3].

    Raises
    ------
    NotClosedError
        On every rank, if no field crosses none of the planes that close the surface.
    """

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        facets: Array,
        kinematics: Kinematics = SOLID,
        closing: ClosingSurface | None = None,
    ) -> None:
        # The integrands are polynomials of this degree in each direction of a facet.
        self._degree = 3 * max(_dolfinx.degree(V), _dolfinx.geometry_degree(V.mesh)) - 1
        rule = {"metadata": {"quadrature_degree": self._degree}}
        groups, lids = [facets], closing.lids if closing else {}
        groups += [closing.facets_of_part(part, facets) for part in lids] if closing else []
        self._closing = closing
        self._lids: list[tuple[Fan, float, Any]] = []
        self._ds, *on_parts = (m(**rule) for m in _dolfinx.surface_measures(V.mesh, groups))
        self.V = V
        self._u = _dolfinx.function(V, "displacement")
        self._kinematics, self._X = kinematics, ufl.SpatialCoordinate(V.mesh)
        dim = kinematics.dim
        self._A = _dolfinx.constant(V.mesh, np.eye(dim) / dim)
        self._b = _dolfinx.constant(V.mesh, np.zeros(dim))
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
        if closing:
            if not kinematics.revolved:
                self._A.value[:], self._b.value[:] = closing.field(self._centre)
            self._compiled = _dolfinx.form(self._form)
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


def _centre(domain: _dolfinx.Mesh) -> Array:
    """Return the centre of the bounding box of the nodes (3,) [m]. Collective."""
    boxes = domain.comm.allgather(_dolfinx.bounding_box(domain))
    return (np.min(boxes, axis=0)[0] + np.max(boxes, axis=0)[1]) / 2
