"""Quadrature on the boundary: areas, normals, forces and stiffnesses against UFL forms."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from bodies import cube, dense
from polynomials import ELEMENTS, linear, quadratic

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import create_matrix
from fem_snh.assembly.unknowns import add_ghosts, writable_values
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.mesh import mesh

pytestmark = pytest.mark.mpi

each_element = pytest.mark.parametrize("cell, degree", ELEMENTS, ids=["Q1", "P1", "Q2", "P2"])
MATRIX = np.array([[2.0, 1, -1], [0.5, 3, 0], [1, -2, 4]])


def surface(comm, cell, degree, source="cube", **options):
    """A space on a bent cube, or on another body, with the quadrature of its boundary."""
    body = (
        cube(comm, cell, 3, 0.05)
        if source == "cube"
        else mesh.generate(comm, source, cell, **options)
    )
    V = _dolfinx.function_space(body.domain, degree, (3,))
    return body, V, SurfaceQuadrature(V)


@pytest.mark.one_debian("ranks")
@each_element
def test_the_divergence_theorem(comm, cell, degree):
    """The flux of x through the boundary is three volumes; its normals enclose none."""
    body, _, q = surface(comm, cell, degree)
    area_vector = np.einsum("fq,fqi->i", q.weights, q.normals)
    flux = np.einsum("fq,fqi,fqi->", q.weights, q.normals, q.X)
    np.testing.assert_allclose(comm.allreduce(area_vector), 0, atol=1e-14)
    assert comm.allreduce(float(flux)) == pytest.approx(3 * mesh.volume(body.domain), rel=1e-14)
    assert comm.allreduce(len(q)) == 6 * 9 * (1 if cell == "hexahedron" else 2)


@pytest.mark.one_debian("ranks")
@each_element
def test_values_and_derivatives_of_a_polynomial(comm, cell, degree):
    _, V, q = surface(comm, cell, degree)
    field = quadratic if degree == 2 and cell == "tetrahedron" else linear
    u = field(V.tabulate_dof_coordinates().T).T
    np.testing.assert_allclose(
        q.displacements(u), field(q.X.reshape(-1, 3).T).T.reshape(q.X.shape), atol=1e-13
    )
    some = np.arange(0, len(q), 2)
    np.testing.assert_allclose(q.positions(u, some), (q.X + q.displacements(u))[some], atol=1e-15)
    X = V.tabulate_dof_coordinates()
    a, b = np.moveaxis(np.einsum("fki,pkj->fpij", X[q.nodes], q.derivatives), 3, 0)
    direction = np.cross(a, b)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    np.testing.assert_allclose(np.abs((direction * q.normals).sum(axis=2)), 1, rtol=1e-12)


@pytest.mark.one_debian("ranks")
@each_element
def test_vectors_and_matrices_are_those_of_ufl(comm, cell, degree):
    """On some facets of the boundary: a force and a stiffness that are linear in x."""
    body, V, _ = surface(comm, cell, degree)
    group = body.group("top").entities
    q = SurfaceQuadrature(V, group, degree=6)
    some = np.arange(len(q))
    factor = 1 + q.X[..., 0] + q.X[..., 1]
    ds = _dolfinx.surface_measure(body.domain, group)
    x, test, trial = _dolfinx.coordinates(body.domain), ufl.TestFunction(V), ufl.TrialFunction(V)
    f = _dolfinx.create_vector(V)
    q.add_vectors(
        (q.weights * factor)[..., None] * MATRIX[0], some, writable_values(f).reshape(-1, 3)
    )
    add_ghosts(f)
    M, c = ufl.as_matrix(MATRIX.tolist()), 1 + x[0] + x[1]
    expected = _dolfinx.create_vector(V)
    _dolfinx.assemble_vector(expected, _dolfinx.form(c * ufl.dot(M[0, :], test) * ds))
    np.testing.assert_allclose(f.array_r, expected.array_r, atol=1e-14)
    made = create_matrix(V)
    curvature = np.broadcast_to(MATRIX, (*q.X.shape, 3))
    columns = -factor, np.zeros_like(factor), np.zeros_like(q.X), curvature
    rows, matrices, _ = q.loops.contact_matrices(some, columns, "exact", 1.0)
    with made.adding():
        made.add_matrices(q.cells[rows], matrices)
    form = _dolfinx.form(c * ufl.inner(test, ufl.dot(M, trial)) * ds)
    A = _dolfinx.create_matrix(form)
    _dolfinx.assemble_matrix(A, form)
    np.testing.assert_allclose(dense(made.mat), dense(A), atol=1e-14)
