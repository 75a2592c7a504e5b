"""Inertia: so far the mass matrix, for eigenfrequencies."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx


def mass_matrix(V: Any, density: float) -> PETSc.Mat:
    """The consistent mass matrix [kg] of the space V for a density [kg/m^3]. Collective."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    rho = _dolfinx.constant(V.mesh, np.array(density))
    form = _dolfinx.form(rho * ufl.inner(u, v) * ufl.dx)
    M = _dolfinx.create_matrix(form)
    _dolfinx.assemble_matrix(M, form)
    return M
