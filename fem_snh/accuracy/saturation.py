r"""How much of the error the lifted solution leaves, from the decay of its own degrees.

The error of an element of degree p on a given mesh decreases as :math:`C p^{-\beta}` where the
solution is singular (Babuska & Suri 1987), and faster where it is smooth. A lifted solution of
degree 3 has the parts of degree 2 and 3 in each cell, of squares

.. math:: a_k = \int_K \lvert \nabla (I_k u_+ - I_{k-1} u_+) \rvert^2 \, \mathrm{d}V,

with the nodal interpolations I_k of degree k. Their ratio gives the cell's :math:`\beta`, and so
the sum of all further parts. The estimate is multiplied by the sum of the parts from degree 3 on,
over all cells, divided by that of degree 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import log
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.ghosted_vectors import local_values
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]

#: Exponents between which the decay of a cell is sought. 2 is that of a crack in linear elasticity,
#: with the square root of the distance. At the edge of the clamped face of a nearly incompressible
#: body strains are finite, and cells have exponents of 0.8 to 1.2: with 1.5 the estimates are right
#: there (docs/theory/error.md). At 12 a further degree leaves less than a hundredth.
_EXPONENTS = np.linspace(1.5, 12.0, 211)

#: Cells that are evaluated together: some 10 MB of gradients.
_BATCH = 2000


def saturation(lifted: Problem, u: PETSc.Vec) -> float:
    """Return the factor of estimates by a lifted displacement, at least 1. Collective.

    ``u`` is a ghosted vector: the solution, or a mode of vibration.
    A lifted solution of degree 2 has one part alone, and no ratio: the factor is 1.
    """
    if lifted.element.degree < 3:
        return 1.0
    second, third = _parts(lifted, u)
    ratio = np.divide(third, second, out=np.zeros_like(third), where=second > 0)
    further = np.interp(ratio, *_table())
    sums = lifted.comm.allreduce(np.array([third.sum(), (third * further).sum()]))
    return float(1 + sums[1] / sums[0]) if sums[0] > 0 else 1.0


def _table() -> tuple[Array, Array]:
    """Return ratios a_3/a_2, increasing, and the sums of a_k, k > 3, over a_3."""
    powers = {p: np.exp(-log(p) * _EXPONENTS) for p in (2, 3)}
    ratio = (powers[2] - powers[3]) / (1 - powers[2])
    further = powers[3] / (powers[2] - powers[3])
    return ratio[::-1], further[::-1]


def cell_squares(problem: Problem, vector: PETSc.Vec) -> Array:
    """Return the integral of the squared gradient of a displacement over each owned cell.

    ``vector`` is ghosted.
    """

    def squares(u: Array, X: Array) -> Array:
        volumes, (gradient,) = _gradients(problem, u, X, [problem.element.degree])
        return np.asarray((volumes * (gradient**2).sum(axis=(2, 3))).sum(axis=1))

    return _in_batches(problem, vector, squares)


def _parts(lifted: Problem, vector: PETSc.Vec) -> tuple[Array, Array]:
    """Return a_2 and a_3 of each cell of this rank."""

    def parts(u: Array, X: Array) -> Array:
        volumes, gradients = _gradients(lifted, u, X, [1, 2, 3])
        steps = [new - old for old, new in pairwise(gradients)]
        return np.stack([(volumes * (d**2).sum(axis=(2, 3))).sum(axis=1) for d in steps], axis=1)

    second, third = _in_batches(lifted, vector, parts).reshape(-1, 2).T
    return second, third


def _in_batches(
    problem: Problem, vector: PETSc.Vec, evaluate: Callable[[Array, Array], Array]
) -> Array:
    """Return a function of the displacements and coordinates of the nodes of owned cells."""
    u = local_values(vector).reshape(-1, problem.kinematics.components)
    nodes = _dolfinx.node_dofs(problem.V)
    geometry = _dolfinx.geometry_dofs(problem.domain)
    X = _dolfinx.geometry_x(problem.domain)[:, : problem.kinematics.dim]
    batches: list[Array] = []
    for first in range(0, len(nodes), _BATCH):
        batch = slice(first, first + _BATCH)
        batches.append(evaluate(u[nodes[batch]], X[geometry[batch]]))
    return np.concatenate(batches) if batches else np.empty(0)


def _gradients(
    problem: Problem, u: Array, X: Array, degrees: Sequence[int]
) -> tuple[Array, list[Array]]:
    """Return the volumes of quadrature points, and gradients of interpolations by degree.

    From displacements and coordinates of the cells' nodes: (cells, points), and for each degree
    (cells, points, components, dim).
    """
    cell, degree = problem.element.cell, problem.element.degree
    points, weights = _dolfinx.quadrature(cell, problem.element.quadrature)
    tangents = _dolfinx.tabulate_geometry(problem.domain, points)
    jacobians = np.einsum("cgi,pgj->cpij", X, tangents, optimize=True)
    volumes = weights * np.abs(np.linalg.det(jacobians))
    if problem.kinematics.revolved:
        volumes *= X[..., 0] @ _dolfinx.tabulate_geometry_values(problem.domain, points).T
    inverse = np.linalg.inv(jacobians)
    gradients = []
    for k in degrees:
        nodes = _dolfinx.reference_nodes(cell, k)
        values = _dolfinx.tabulate_element(cell, degree, nodes, 0)[0] @ u
        basis = _dolfinx.tabulate_element(cell, k, points, 1)[1:]
        reference = np.einsum("jpk,cki->cpij", basis, values, optimize=True)
        gradients.append(reference @ inverse)
    return volumes, gradients
