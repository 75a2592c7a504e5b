"""Mean dilatation and Taylor-Hood by hand: energy, forces and filtered matrices, in numpy and UFL.

An independent implementation of the split is the oracle: the volume terms below, their derivatives
and their conjugates are typed in, cells are summed in numpy, and UFL derives the rest.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import cube, dense, norm, one_cell, wave
from volume_energies import (
    ENERGIES,
    HOLD,
    MEAN,
    MIXED,
    moduli,
    mpi,
    pairs,
    problem,
    set_inverted_state,
    set_state,
)

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS

# --- cell by cell --------------------------------------------------------------------------------

LEVI_CIVITA = np.zeros((3, 3, 3))
for i, j, k in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
    LEVI_CIVITA[i, j, k], LEVI_CIVITA[j, i, k] = 1, -1


def cofactor(F):
    """dJ/dF, also of a singular F."""
    return np.einsum("ikm,jln,kl,mn->ij", LEVI_CIVITA, LEVI_CIVITA, F, F) / 2


def curvature(F):
    """d2J/dF2, (9, 9) on vec(F) by columns."""
    return np.einsum("ikm,jln,mn->jilk", LEVI_CIVITA, LEVI_CIVITA, F).reshape(9, 9)


def vec(F):
    return F.T.ravel()


def cells(p):
    """Per cell: its nodes; weights; F; B with vec(dF) = B du; values of the pressure's basis."""
    kind = p.element
    points, weights = _dolfinx.quadrature(kind.cell, kind.quadrature)
    basis = _dolfinx.tabulate(p.V, points)
    geometry = _dolfinx.tabulate_geometry(p.domain, points)
    x, u = _dolfinx.geometry_x(p.domain), p.u.x.array.reshape(-1, 3)
    for nodes, corners in zip(
        _dolfinx.node_dofs(p.V), _dolfinx.geometry_dofs(p.domain), strict=True
    ):
        T = [x[corners].T @ g for g in geometry]
        G = [b @ np.linalg.inv(t) for b, t in zip(basis, T, strict=True)]
        F = [np.eye(3) + u[nodes].T @ g for g in G]
        # entry 3 j + i of vec(F) is F_ij = ... + u_ai G_aj
        B = [np.einsum("aj,ik->jiak", g, np.eye(3)).reshape(9, -1) for g in G]
        yield nodes, weights * abs(np.linalg.det(T)), F, B


def pressures(p, volume, w, F, cell):
    """At each point of a cell: of the cell's mean J, or the unknown pressure's value."""
    if p.element.volume == "mean":
        mean = w @ np.linalg.det(F) / w.sum()
        return np.full(len(w), volume.curve(mean, moduli(p)[2])[1])
    Q, values = p.saddle_point.Q, p.saddle_point.pressure()
    points, _ = _dolfinx.quadrature(p.element.cell, p.element.quadrature)
    return _dolfinx.tabulate_values(Q, points) @ values[_dolfinx.node_dofs(Q)[cell]]


FILTERS = {"exact": lambda e: e, "clamp": lambda e: np.maximum(e, 0), "abs": np.abs}


def block_by_hand(p, volume, keep):
    """The displacement's block: sum of w B^T H B and, of a mean, U'' g g^T / V a cell."""
    k = moduli(p)[2]
    A = np.zeros((len(p.u.x.array),) * 2)
    for cell, (nodes, w, F, B) in enumerate(cells(p)):
        dofs = np.ix_(*[(3 * nodes[:, None] + np.arange(3)).ravel()] * 2)
        gradient = 0.0
        for q, pressure in enumerate(pressures(p, volume, w, F, cell)):
            J, c = np.linalg.det(F[q]), vec(cofactor(F[q]))
            _, slope, bend = volume.curve(J, k)
            H = p.regions[0].material.hessian(F[q]) - bend * np.outer(c, c)
            H += (pressure - slope) * curvature(F[q])
            e, X = np.linalg.eigh(H)
            A[dofs] += w[q] * B[q].T @ (X @ np.diag(keep(e)) @ X.T) @ B[q]
            gradient = gradient + w[q] * B[q].T @ c
        if p.element.volume == "mean":
            mean = w @ np.linalg.det(F) / w.sum()
            stiff = keep(np.array(volume.curve(mean, k)[2]))
            A[dofs] += stiff / w.sum() * np.outer(gradient, gradient)
    return A


@pytest.mark.one_debian("serial")
@pairs(MIXED)
@pytest.mark.parametrize("choice", FILTERS)
def test_filters_are_numpys_eigh_at_every_point(element, name, choice):
    """One cell that is no unit cell, inverted at some points."""
    p = problem(one_cell(MPI.COMM_SELF, ELEMENTS[element].cell), element, name)
    set_inverted_state(p, p.regions[0].material.expression.inversion_safe)
    p.jacobian(p.x, choice)
    found = dense(p.A)
    n = 3 * _dolfinx.num_nodes(p.V)[0]
    expected = block_by_hand(p, ENERGIES[name], FILTERS[choice])
    assert abs(found[:n, :n] - expected).max() <= 1e-10 * abs(expected).max()
    assert abs(found - found.T).max() <= 1e-14 * abs(found).max()
    if choice == "exact":
        assert np.linalg.eigvalsh(expected)[0] < 0  # there was something to filter
    elif element in MEAN:
        e = np.linalg.eigvalsh(found)
        assert e[0] >= -1e-12 * e[-1]


@pytest.mark.one_debian("serial")
@pairs(MEAN)
def test_mean_dilatation_energy(element, name):
    """psi - U(J) at each point, and U of the mean of J once a cell."""
    p = problem(cube(MPI.COMM_SELF, ELEMENTS[element].cell, 2, 0.05), element, name)
    set_state(p, wave(0.05))
    found, volume = p.energy(p.x), ENERGIES[name]
    k, expected = moduli(p)[2], 0.0
    for _, w, F, _ in cells(p):
        J = np.linalg.det(F)
        points = p.regions[0].material.energy(F) - volume.curve(J, k)[0]
        expected += w @ points + w.sum() * volume.curve(w @ J / w.sum(), k)[0]
    assert found == pytest.approx(expected, rel=1e-12)


#: Central differences of order 8: (multiple of the step, weight).
STENCIL = [(1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280)]


def difference(function, x, d, h):
    """d/ds function(x + s d) at s = 0."""
    total, moved = 0.0, x.duplicate()
    for multiple, weight in STENCIL:
        for sign in (1, -1):
            moved.waxpy(sign * multiple * h, d, x)
            total = total + sign * weight / h * function(moved)
    return total


@pytest.mark.one_debian
@mpi
@pairs([*MIXED, "P2"])
def test_residual_and_jacobian_are_derivatives(comm, element, name):
    """Of the energy and of the residual, along a random direction, pressures included."""
    p = problem(cube(comm, ELEMENTS[element].cell, 2, 0.05), element, name, hold=HOLD)
    set_state(p, wave(0.03), 0.3)
    r, d, Ad = (p.x.duplicate() for _ in range(3))
    d.array[:] = np.random.default_rng(comm.rank).uniform(-1, 1, d.getLocalSize())
    d.array[p.constrained_dofs] = 0
    p.residual(p.x, r)
    slope = difference(p.energy, p.x, d, 2e-3)
    assert slope == pytest.approx(r.dot(d), abs=1e-9 * r.norm() * d.norm())

    def residual(x):
        p.residual(x, r)
        return r.array.copy()

    found = difference(residual, p.x, d, 2e-3)
    p.jacobian(p.x, "exact")
    p.A.mult(d, Ad)
    free = np.ones(len(found), bool)
    free[p.constrained_dofs] = False
    assert norm(comm, (found - Ad.array)[free]) <= 1e-9 * norm(comm, found)
