"""Dead loads on physical groups of surfaces."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

from petsc4py import PETSc

import ufl

from fem_snh import _dolfinx
from fem_snh.errors import bad_value
from fem_snh.fem.mesh import Mesh


class SurfaceLoad(Protocol):
    """A force per reference area on a physical group."""

    @property
    def group(self) -> str | int:
        """Name or number of the physical group."""

    @property
    def vector(self) -> Sequence[float]:
        """The (3,) force per reference area [Pa]."""


class Traction:
    r"""Dead loads, scaled by the load parameter.

    .. math:: E = -\lambda \sum_i \int_{\Gamma_i} t_i \cdot u \, \mathrm{d}A

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mesh : Mesh
        The mesh whose physical groups the loads name.
    loads : iterable of SurfaceLoad
        The tractions t_i [Pa] on the surfaces Gamma_i.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or not a surface.
    """

    name = "traction"
    has_energy = depends_on_load = True

    def __init__(self, V: Any, mesh: Mesh, loads: Iterable[SurfaceLoad]) -> None:
        self._load = 0.0
        self._force = _dolfinx.create_vector(V)
        test = ufl.TestFunction(V)
        part = self._force.duplicate()
        for load in loads:
            group = mesh.group(load.group)
            if group.dim != 2:
                raise bad_value("traction.group", load.group, f"a surface, not a {group.label}")
            ds = _dolfinx.surface_measure(mesh.domain, group.entities)
            integral = ufl.inner(_dolfinx.constant(mesh.domain, load.vector), test) * ds
            # One form per load: UFL accepts one set of marked facets per form.
            _dolfinx.assemble_vector(part, _dolfinx.form(integral))
            self._force.axpy(1.0, part)

    def set_load(self, load: float) -> None:
        """Set the load parameter lambda."""
        self._load = load

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return -load * f . u [J], f the integral of the tractions. Collective."""
        return -self._load * float(self._force.dot(u))

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Subtract load * f [N] from the owned entries of ``r_u``."""
        r_u.array[:] -= self._load * self._force.array_r

    def add_hessian(self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: Any) -> int:
        """Add nothing: a dead load has no Hessian."""
        return 0
