"""An oracle of the mass matrix: dolfinx assembles its form in UFL."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx


def mass_matrix(V: _dolfinx.FunctionSpace, density: Any, revolved: bool = False) -> PETSc.Mat:
    """Return the consistent mass matrix [kg] of the space V. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    density : float or dolfinx Function
        Mass per reference volume [kg/m^3].
    revolved : bool, optional
        Whether the body is the mesh revolved about the axis x = 0.
    """
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    rho = _dolfinx.constant(V.mesh, np.array(density)) if np.isscalar(density) else density
    if revolved:
        rho *= 2 * ufl.pi * _dolfinx.coordinates(V.mesh)[0]
    form = _dolfinx.form(rho * ufl.inner(u, v) * ufl.dx)
    M = _dolfinx.create_matrix(form)
    _dolfinx.assemble_matrix(M, form)
    return M
