r"""The L2 projection of values at quadrature points to the nodes of a mesh.

The projection f of a field g is the continuous function of degree 1 with, for each vertex a,

.. math:: \int_\Omega N_a f \, \mathrm{d}V = \sum_q w_q N_a(x_q) g(x_q) .

It is exact where g is constant. It may overshoot where g jumps, as between two materials.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from scipy.sparse import csr_matrix

from fem_snh import _dolfinx
from fem_snh.fem.problem import Problem

Array = npt.NDArray[np.float64]

#: Relative residual of the mass matrix's linear systems: its condition number is about 10.
_TOLERANCE = 1e-13


class NodalProjection:
    """The L2 projection to the displacement's nodes, through those of degree 1. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, whose element has the quadrature rule.
    weights : (cells, points)
        Quadrature weights of this rank's cells [m^3].
    """

    def __init__(self, problem: Problem, weights: Array) -> None:
        V, element = problem.V, problem.element
        self._space = Q = _dolfinx.function_space(problem.domain, 1)
        points, _ = _dolfinx.quadrature(element.cell, element.quadrature)
        self._integration = _integration(Q, points, weights)
        self._right, self._solution = _dolfinx.create_vector(Q), _dolfinx.create_vector(Q)
        nodes = _dolfinx.reference_nodes(element.cell, element.degree)
        self._table = _dolfinx.tabulate_values(Q, nodes)
        self._nodes = _dolfinx.node_dofs(V)
        self._num_nodes = sum(_dolfinx.num_nodes(V))
        form = _dolfinx.form(ufl.TrialFunction(Q) * ufl.TestFunction(Q) * ufl.dx)
        mass = _dolfinx.create_matrix(form)
        _dolfinx.assemble_matrix(mass, form)
        self._solver = PETSc.KSP().create(problem.comm)
        self._solver.setOperators(mass)
        self._solver.setType("cg")
        self._solver.getPC().setType("jacobi")
        self._solver.setTolerances(rtol=_TOLERANCE)

    def project(self, values: Array) -> Array:
        """Return a field at this rank's displacement nodes, ghosts included. Collective.

        Parameters
        ----------
        values : (cells, points, ...)
            The field at the quadrature points.

        Returns
        -------
        (nodes, ...)
        """
        shape = values.shape[2:]
        columns = values.reshape(values.shape[0] * values.shape[1], -1)
        at_vertices = np.column_stack([self._solve(b) for b in (self._integration @ columns).T])
        cells = at_vertices[_dolfinx.node_dofs(self._space)]
        found = np.empty((self._num_nodes, columns.shape[1]))
        found[self._nodes] = self._table @ cells
        return found.reshape(self._num_nodes, *shape)

    def _solve(self, integrals: Array) -> Array:
        """Return the values at the vertices, ghosts included. Collective."""
        with self._right.localForm() as local:
            local.array[:] = integrals
        self._right.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self._solver.solve(self._right, self._solution)
        self._solution.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        with self._solution.localForm() as local:
            return np.array(local.array_r)


def _integration(Q: object, points: Array, weights: Array) -> csr_matrix:
    """Return the matrix (nodes of Q, quadrature points) of the integrals against Q's basis."""
    basis = _dolfinx.tabulate_values(Q, points)
    values = weights[:, :, None] * basis  # (cells, points, nodes)
    rows = np.broadcast_to(_dolfinx.node_dofs(Q)[:, None], values.shape)
    columns = np.broadcast_to(np.arange(weights.size).reshape(*weights.shape, 1), values.shape)
    shape = sum(_dolfinx.num_nodes(Q)), weights.size
    return csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
