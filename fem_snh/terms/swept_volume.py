r"""The volume that a deformed surface sweeps: the potential of a uniform pressure.

A pressure p on a surface has the virtual work

.. math:: R(u; v) = p \int_\Gamma \mathrm{cof}(F) N \cdot v \, \mathrm{d}A

(Bonet & Wood 2008, section 8.5), N the body's outward normal. The work of p = 1 on the straight
path to u is the volume that the surface sweeps,

.. math:: S(u) = \int_0^1 R(t u; u) \, \mathrm{d}t ,

whose integrand is quadratic in t. If the volume that the closing surface sweeps
(`fem_snh.terms.closing_surface`) does not depend on free displacements, the pressure is
conservative, with the energy p S. In a plane S is an area.

A rigid part with an edge of the surface closes it by a lid, whose work the integral lacks. With the
lid's vector area a and moment M at rest about a point X of the part, and the part's rotation R, the
work of a unit pressure on the lid is

.. math:: R a \cdot v + \delta R : R M, \quad M = \int N (Y - X)^T \, \mathrm{d}A .

It is evaluated as the mean over points X of the part's facets, on which F = R along the facet and
cof(F) N = R N; so its derivatives are local. On a body of revolution the lid is a disc.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import ufl
from ufl.algorithms import estimate_total_polynomial_degree, expand_derivatives

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.unknowns import copy_to_function
from fem_snh.terms.body import displacement_gradient
from fem_snh.terms.closing_surface import PATH, ClosingSurface, Lid, NotClosedError


class SweptVolume:
    """The volume S that a surface sweeps as it deforms, and a pressure's work. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    facets : (n,) int
        This rank's facets of the surface.
    kinematics : Kinematics, optional
        How the displacement becomes a deformation gradient.
    closing : ClosingSurface, optional
        The closing surface. Without it `change` fails, and `residual` has no lids.

    Raises
    ------
    NotClosedError
        On every rank, if a rigid part with a lid has no facets beside those of the surface.
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
        self._ds, *on_parts = (m(**rule) for m in _dolfinx.surface_measures(V.mesh, groups))
        self.V, self._closing = V, closing
        self._u = _dolfinx.function(V, "displacement")
        self._kinematics, self._X = kinematics, ufl.SpatialCoordinate(V.mesh)
        self._lids: list[tuple[Lid, float, Any]] = []
        one = _dolfinx.constant(V.mesh, 1.0)
        for (part, lid), ds in zip(lids.items(), on_parts, strict=True):
            size = _dolfinx.assemble_scalar(_dolfinx.form(one * ds))
            if not size:
                raise NotClosedError(f"rigid part {part + 1} has no other facets of the boundary")
            self._lids.append((lid, size, ds))
        self._compiled = _dolfinx.form(self._swept_to(self._u)) if closing else None

    def residual(self, u: Any, value: Any = 1.0) -> Any:
        """Return the UFL form of the virtual work of a pressure ``value`` [Pa], v a test function.

        It is the integral of value cof(F) N . v, plus the work on lids; with lids, ``value`` must
        be uniform.
        """
        form = self._work(u, value)
        return form + value * self._work_on_lids(u) if self._lids else form

    def _work(self, u: Any, value: Any = 1.0) -> Any:
        density = value * ufl.inner(self._normal(u), ufl.TestFunction(self.V))
        if self._kinematics.revolved:
            density *= 2 * ufl.pi * self._X[0]
        degree = self._degree + estimate_total_polynomial_degree(ufl.as_ufl(value))
        return density * self._ds(metadata={"quadrature_degree": degree})

    def _swept_to(self, end: Any) -> Any:
        """Return the UFL form of the work of p = 1 on the straight path to the displacement."""
        work, v = self._work(self._u), ufl.TestFunction(self.V)
        return sum(weight * ufl.replace(work, {v: end, self._u: t * end}) for t, weight in PATH)

    def _work_on_lids(self, u: Any) -> Any:
        """Return the UFL form of the work of a unit pressure on the lids.

        It is the sum over lids of a mean over the facets of the lid's part.
        """
        domain, dim, total = self.V.mesh, self._kinematics.dim, 0
        v, N, unit = ufl.TestFunction(self.V), ufl.FacetNormal(domain), ufl.Identity(dim)
        ahead = ufl.as_vector([v[i] for i in range(dim)])
        for lid, size, ds in self._lids:
            area = _dolfinx.constant(domain, lid.area / size)
            if self._kinematics.revolved:  # F N is not R N
                total += ufl.dot(area, ahead) * ds
                continue
            arm = self._X - _dolfinx.constant(domain, lid.apex)
            moment = _dolfinx.constant(domain, lid.moment / size) - ufl.outer(area, arm)
            along = ufl.dot(unit + ufl.grad(u), unit - ufl.outer(N, N))
            R = along + ufl.outer(self._normal(u), N)
            turned = expand_derivatives(ufl.derivative(R, u, v))
            work = ufl.dot(ufl.dot(R, area), ahead) + ufl.inner(turned, ufl.dot(R, moment))
            total += work * ds
        return total

    def change(self, u: PETSc.Vec) -> float:
        """Return the change of the enclosed volume [m^3], positive along N. Collective.

        It is S plus the volume that the closing surface sweeps.
        """
        assert self._closing is not None
        copy_to_function(u, self._u)
        return _dolfinx.assemble_scalar(self._compiled) + self._closing.swept(u)

    def at_rest(self) -> float | None:
        """Return the enclosed volume at rest [m^3], or None if it is unknown. Collective.

        It is negative if N points into the volume. `ClosingSurface.collapse` determines it.
        """
        if self._closing is None or (found := self._closing.collapse()) is None:
            return None
        K, point, swept = found
        K, point = (_dolfinx.constant(self.V.mesh, numbers) for numbers in (K, point))
        way, dim = ufl.dot(K, point - self._X), self._kinematics.dim
        end = [way[i] for i in range(dim)] + [0.0] * (self._kinematics.components - dim)
        form = _dolfinx.form(self._swept_to(ufl.as_vector(end)))
        return -_dolfinx.assemble_scalar(form) - swept

    def _normal(self, u: Any) -> Any:
        """Return cof(F) N in UFL, (components,), without a division by det F."""
        kinematics = self._kinematics
        F = ufl.Identity(3) + displacement_gradient(u, kinematics)
        a, b, c = (ufl.as_vector([F[i, k] for i in range(3)]) for k in range(3))
        N = ufl.FacetNormal(self.V.mesh)
        if kinematics.dim == 3:
            return N[0] * ufl.cross(b, c) + N[1] * ufl.cross(c, a) + N[2] * ufl.cross(a, b)
        normal = N[0] * ufl.cross(b, c) + N[1] * ufl.cross(c, a)
        return ufl.as_vector([normal[i] for i in range(kinematics.components)])
