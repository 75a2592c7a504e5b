"""Dead loads on physical groups of surfaces."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from petsc4py import PETSc

import ufl

from fem_snh import _dolfinx
from fem_snh.errors import BadInput
from fem_snh.fem.mesh import Mesh


class Traction:
    """Tractions per reference area, scaled by the load: E = -load * integral of t . u.

    Parameters
    ----------
    loads : (group, vector [Pa]) pairs; a group is a surface of ``mesh``.

    Raises BadInput for a group that is no surface.
    """

    name = "traction"

    def __init__(self, V: Any, mesh: Mesh, loads: Iterable[tuple[str | int, Any]]) -> None:
        self.load = 0.0
        self._force = _dolfinx.create_vector(V)
        test = ufl.TestFunction(V)
        part = self._force.duplicate()
        for key, vector in loads:
            group = mesh.group(key)
            if group.dim != 2:
                raise BadInput(f"traction on '{key}': it must be a surface, not a {group.label}")
            ds = _dolfinx.surface_measure(mesh.domain, group.entities)
            term = ufl.inner(_dolfinx.constant(mesh.domain, vector), test) * ds
            # A form each: UFL takes one set of marked facets a form.
            _dolfinx.assemble_vector(part, _dolfinx.form(term))
            self._force.axpy(1.0, part)

    def energy(self, u: PETSc.Vec) -> float:
        """-load * f . u [J]."""
        return -self.load * float(self._force.dot(u))

    def add_residual(self, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """r -= load * f [N], at owned nodes."""
        r.array[:] -= self.load * self._force.array_r
