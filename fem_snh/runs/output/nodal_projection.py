r"""The L2 projection of values at quadrature points to the nodes of a mesh.

The projection f of a field g is the continuous function of degree 1 with, for each vertex a,

.. math:: \int_\Omega N_a f \, \mathrm{d}V = \sum_q w_q N_a(x_q) g(x_q) .

It is exact where g is constant. It may overshoot where g jumps, as between two materials. On a body
of revolution the integrals are those over its section: the factor 2 pi r would take from a rule its
exactness, and from a constant.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import numpy.typing as npt
import ufl
from scipy.sparse import csr_matrix

from fem_snh import _dolfinx
from fem_snh.linalg.columns_cg import LANES, ColumnsCG
from fem_snh.linalg.halo import Halo
from fem_snh.problem.problem import Problem
from fem_snh.runs.output.point_fields import PointFieldLoops

Array = npt.NDArray[np.float64]

#: Relative residual of the mass matrix's linear systems. With a unit diagonal its condition number
#: is at most 27 (Wathen 1987), so the residual of the recurrence is the true one to rounding.
_TOLERANCE = 1e-13
#: Components of a symmetric tensor that are projected, and where they are in its rows.
_UPPER = np.array([0, 1, 2, 4, 5, 8])
_SYMMETRIC = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])
#: Values of a basis function below this are zero: they are rounding errors of its tabulation.
_ROUNDING = 1e-12


class NodalProjection:
    """The L2 projection to the displacement's nodes, through those of degree 1. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, whose element has the quadrature rule.
    weights : (cells, points)
        Quadrature weights of this rank's cells [m^3], on a body of revolution of the whole turn.
    """

    def __init__(self, problem: Problem, weights: Array) -> None:
        V, element = problem.V, problem.element
        Q = _dolfinx.function_space(problem.domain, 1)
        points, _ = _dolfinx.quadrature(element.cell, element.quadrature)
        if problem.kinematics.revolved:
            weights = weights / (2 * np.pi * _radii(problem.domain, points))
        self._weights, self._basis = weights, _dolfinx.tabulate_values(Q, points)
        self._vertices = np.ascontiguousarray(_dolfinx.node_dofs(Q), np.int32)
        self._loops = PointFieldLoops(problem.comm)
        nodes = _dolfinx.reference_nodes(element.cell, element.degree)
        self._interpolation = _interpolation(V, Q, _dolfinx.tabulate_values(Q, nodes))
        form = _dolfinx.form(ufl.TrialFunction(Q) * ufl.TestFunction(Q) * ufl.dx)
        mass = _dolfinx.create_matrix(form)
        _dolfinx.assemble_matrix(mass, form)
        self._owned = _dolfinx.num_nodes(Q)[0]
        ghosts = _dolfinx.local_to_global(Q)[self._owned :]
        first = mass.getOwnershipRanges()
        self._halo = Halo(problem.comm, first, ghosts, LANES, np.float64)
        self._solver = ColumnsCG(mass, _TOLERANCE)

    def project(
        self, fields: Mapping[str, Array], symmetric: Collection[str] = ()
    ) -> dict[str, Array]:
        """Return fields at this rank's displacement nodes, ghosts included. Collective.

        Parameters
        ----------
        fields : mapping of (cells, points, ...)
            The fields at the quadrature points, by name.
        symmetric : collection of str
            Names of those that are symmetric tensors, for which six components are projected.

        Returns
        -------
        dict of (nodes, ...)
        """
        columns: list[Array] = []
        parts = {}
        for name, values in fields.items():
            flat = values.reshape(*values.shape[:2], -1)
            chosen = _UPPER if name in symmetric else range(flat.shape[2])
            parts[name] = slice(len(columns), len(columns) + len(chosen))
            columns += [flat[..., k] for k in chosen]
        at_vertices = self._solve(columns)
        at_nodes = self._interpolation @ at_vertices
        found = {}
        for name, part in parts.items():
            values = at_nodes[:, part]
            if name in symmetric:
                values = values[:, _SYMMETRIC]
            found[name] = values.reshape(len(values), *fields[name].shape[2:])
        return found

    def _solve(self, columns: list[Array]) -> Array:
        """Return the projections at the vertices, ghosts included, (vertices, columns)."""
        size = self._interpolation.shape[1]
        blocks = self._loops.integrate(columns, self._vertices, self._weights, self._basis, size)
        owned, ghosts = blocks[:, : self._owned], blocks[:, self._owned :]
        for mine, others in zip(owned, ghosts, strict=True):
            self._halo.add(others, mine)
        self._solver.solve(owned)
        for mine, others in zip(owned, ghosts, strict=True):
            self._halo.exchange(mine)
            others[:] = self._halo.ghosts
        return blocks.transpose(1, 0, 2).reshape(size, -1)


def _radii(domain: object, points: Array) -> Array:
    """Return the radius x at each cell's points of the reference cell, (cells, points)."""
    radii = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain), 0]
    return np.asarray(radii @ _dolfinx.tabulate_geometry_values(domain, points).T)


def _interpolation(V: object, Q: object, table: Array) -> csr_matrix:
    """Return the matrix (nodes of V, vertices) of a function of degree 1 at the nodes of V.

    ``table`` has the values of its basis at the nodes of the reference cell.
    """
    nodes, first = np.unique(_dolfinx.node_dofs(V), return_index=True)
    cells, local = np.divmod(first, len(table))
    values = table[local]
    columns = _dolfinx.node_dofs(Q)[cells]
    used = abs(values) > _ROUNDING
    rows = np.broadcast_to(nodes[:, None], values.shape)
    shape = sum(_dolfinx.num_nodes(V)), sum(_dolfinx.num_nodes(Q))
    return csr_matrix((values[used], (rows[used], columns[used])), shape=shape)
