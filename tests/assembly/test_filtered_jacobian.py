"""The filtered Jacobian: symmetric, semidefinite, equal to a filter by numpy at every point."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import POINTWISE, dense, one_cell, pairs, problem
from volume_energies import set_inverted_state

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS, Element


def by_hand(p, element: Element, clamp):
    """sum over points of weight B^T H B, with H clamped by numpy's eigh; one rank."""
    points, weights = _dolfinx.quadrature(element.cell, element.quadrature)
    basis = _dolfinx.tabulate(p.V, points)
    geometry = _dolfinx.tabulate_geometry(p.domain, points)
    x = _dolfinx.geometry_x(p.domain)
    u = p.x.array.reshape(-1, 3)
    A, worst = np.zeros((p.dofs, p.dofs)), np.inf
    cells = zip(_dolfinx.node_dofs(p.V), _dolfinx.geometry_dofs(p.domain), strict=True)
    for nodes, corners in cells:
        dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
        for q, weight in enumerate(weights):
            T = x[corners].T @ geometry[q]
            G = basis[q] @ np.linalg.inv(T)
            F = np.eye(3) + u[nodes].T @ G
            # vec(F) by columns: entry 3 j + i is F_ij = ... + u_ai G_aj
            B = np.einsum("aj,ik->jiak", G, np.eye(3)).reshape(9, -1)
            e, Q = np.linalg.eigh(p.regions[0].material.hessian(F))
            worst = min(worst, e.min() / abs(e).max())
            H = Q @ np.diag(clamp(e)) @ Q.T
            A[np.ix_(dofs, dofs)] += weight * abs(np.linalg.det(T)) * B.T @ H @ B
    return A, worst


@pytest.mark.one_debian("serial")
@pairs(POINTWISE, ())
@pytest.mark.parametrize(
    "choice, clamp",
    [("exact", lambda e: e), ("clamp", lambda e: np.maximum(e, 0)), ("abs", np.abs)],
)
def test_filters_are_numpys_eigh_at_every_point(element, name, choice, clamp):
    """One bent cell; as the filtered Hessian's size goes with that of F, so does the bound."""
    p = problem(one_cell(MPI.COMM_SELF, ELEMENTS[element].cell), element, name)
    set_inverted_state(p, p.regions[0].material.expression.inversion_safe)
    p.jacobian(p.x, choice)
    expected, worst = by_hand(p, ELEMENTS[element], clamp)
    assert worst < 0  # there is something to filter
    found = dense(p.A)
    assert abs(found - expected).max() <= 1e-10 * abs(expected).max()
    assert abs(found - found.T).max() <= 1e-14 * abs(found).max()
    e = np.linalg.eigvalsh(found)
    assert choice == "exact" or e[0] >= -1e-12 * e[-1]
