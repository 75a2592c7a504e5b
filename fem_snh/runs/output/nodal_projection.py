r"""The L2 projection of values at quadrature points to the nodes of a mesh.

The projection f of a field g is the continuous function of degree 1 with, for each vertex a,

.. math:: \int_\Omega N_a f \, \mathrm{d}V = \sum_q w_q N_a(x_q) g(x_q) .

It is exact where g is constant. It may overshoot where g jumps, as between two materials. On a body
of revolution the integrals leave out the factor 2 pi r, with which the quadrature rule would not be
exact, and the projection not even of a constant.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh._petsc import jacobi_cg
from fem_snh.arrays import Array
from fem_snh.assembly.unknowns import add_ghosts, writable_values
from fem_snh.problem.problem import Problem

#: Relative residual of the mass matrix's linear systems. With a unit diagonal its condition number
#: is at most 27 (Wathen 1987), so the residual of the recurrence is the true one to rounding.
_TOLERANCE = 1e-13
#: Indices of the projected components among the nine of a symmetric tensor, row by row; and for
#: each of the nine the index of its projected component.
_UPPER = np.array([0, 1, 2, 4, 5, 8])
_SYMMETRIC = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])


class NodalProjection:
    """The L2 projection to degree 1, evaluated at the displacement's nodes. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, whose element has the quadrature rule.
    weights : (cells, points)
        Reference quadrature weights of this rank's cells [m^3]; with the factor 2 pi r on a body of
        revolution.
    """

    def __init__(self, problem: Problem, weights: Array) -> None:
        V, element = problem.V, problem.element
        Q = _dolfinx.function_space(problem.domain, 1)
        points, _ = _dolfinx.quadrature(element.cell, element.quadrature)
        if problem.kinematics.revolved:
            weights = weights / (2 * np.pi * _radii(problem.domain, points))
        self._weights, self._basis = weights, _dolfinx.tabulate_values(Q, points)
        self._vertices = _dolfinx.node_dofs(Q).ravel()
        self._f, self._at_nodes = _dolfinx.function(Q, "f"), _dolfinx.function(V, "f")
        self._load = _dolfinx.create_vector(Q)
        form = _dolfinx.form(ufl.TrialFunction(Q) * ufl.TestFunction(Q) * ufl.dx)
        mass = _dolfinx.create_matrix(form)
        _dolfinx.assemble_matrix(mass, form)
        self._ksp = jacobi_cg(problem.comm, rtol=_TOLERANCE)
        self._ksp.setOperators(mass)

    def project(
        self, fields: Mapping[str, Array], symmetric: Collection[str] = ()
    ) -> dict[str, Array]:
        """Return fields at this rank's displacement nodes, ghosts included. Collective.

        A component is NaN at all nodes if its linear system does not converge, as for values that
        are not finite.

        Parameters
        ----------
        fields : mapping of (cells, points, ...)
            The fields at the quadrature points, by name.
        symmetric : collection of str
            Names of the fields that are symmetric tensors: only six components are projected.

        Returns
        -------
        dict of (nodes, ...)
        """
        found = {}
        for name, values in fields.items():
            flat = values.reshape(*values.shape[:2], -1)
            chosen = _UPPER if name in symmetric else np.arange(flat.shape[2])
            columns = np.stack([self._project(flat[..., k]) for k in chosen], axis=1)
            if name in symmetric:
                columns = columns[:, _SYMMETRIC]
            found[name] = columns.reshape(len(columns), *values.shape[2:])
        return found

    def _project(self, values: Array) -> Array:
        """Return the projection of a scalar, (cells, points), at the nodes."""
        integrals = (self._weights * values) @ self._basis
        sums = np.bincount(self._vertices, integrals.ravel(), len(self._f.x.array))
        writable_values(self._load)[:] = sums
        add_ghosts(self._load)
        solution = _dolfinx.petsc_vec(self._f)
        self._ksp.solve(self._load, solution)
        if self._ksp.reason <= 0:
            solution.set(np.nan)
        self._f.x.scatter_forward()
        self._at_nodes.sub(0).interpolate(self._f)
        nodes = sum(_dolfinx.num_nodes(self._at_nodes.function_space))
        return np.array(self._at_nodes.x.array.reshape(nodes, -1)[:, 0])


def _radii(domain: object, points: Array) -> Array:
    """Return the radius, the coordinate x, at points of the reference cell, (cells, points)."""
    radii = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain), 0]
    return np.asarray(radii @ _dolfinx.tabulate_geometry_values(domain, points).T)
