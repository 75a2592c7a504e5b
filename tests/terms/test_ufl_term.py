"""UFL terms: their Hessian against dolfinx's, filtered element matrices against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from bodies import cube, dense, wave

from fem_snh import _dolfinx
from fem_snh.assembly.unknowns import add_ghosts, update_ghosts
from fem_snh.errors import BadInput
from fem_snh.terms.ufl_term import UFLTerm

mpi = pytest.mark.mpi


class DenseMatrix:
    """A dense matrix to which a term adds element matrices, for every rank's cells."""

    def __init__(self, V):
        self.values = np.zeros((3 * V.dofmap.index_map.size_global,) * 2)
        self._dofs = 3 * _dolfinx.local_to_global(V)[_dolfinx.node_dofs(V)][:, :, None]
        self._comm = V.mesh.comm
        self.cells, self.matrices = [], []

    def add_matrices(self, cells, matrices):
        dofs = (self._dofs[cells] + np.arange(3)).reshape(len(cells), -1)
        np.add.at(self.values, (dofs[:, :, None], dofs[:, None, :]), matrices)
        self.matrices.extend(matrices.copy())

    def total(self):
        """The matrix, on every rank. Collective."""
        return self._comm.allreduce(self.values)


class Body:
    """A displacement on a small bent cube, and forms of it."""

    def __init__(self, comm, cell="hexahedron", degree=1):
        mesh = cube(comm, cell, bend=0.03)
        self.domain = mesh.domain
        self.V = _dolfinx.function_space(self.domain, degree, (3,))
        self.u = _dolfinx.function(self.V, "u")
        self.u.x.array[:] = wave(0.4)(self.V.tabulate_dof_coordinates()).ravel()
        self.x = _dolfinx.petsc_vec(self.u)
        self.v = ufl.TestFunction(self.V)
        self.F = ufl.Identity(3) + ufl.grad(self.u)
        self.k = _dolfinx.constant(self.domain, 3.0)
        self.dx = ufl.Measure("dx", self.domain, metadata={"quadrature_degree": 2})
        self.ds = _dolfinx.surface_measure(self.domain, mesh.group("right").entities)

    def mixed_energy(self):
        """An energy in the volume, on a part of the boundary, and on all of it."""
        quartic = (ufl.inner(self.F, self.F) - 6) ** 2  # a double well
        on_boundary = self.ds.reconstruct(subdomain_id="everywhere")
        spring = self.k * ufl.inner(self.u, self.u)
        return quartic * self.dx + spring * self.ds - 0.1 * spring**2 * on_boundary

    def dolfinx_jacobian(self, residual):
        J = _dolfinx.form(ufl.derivative(residual, self.u))
        A = _dolfinx.create_matrix(J)
        _dolfinx.assemble_matrix(A, J)
        return dense(A)

    def residual(self, term):
        """dE/du of a term on this rank's own dofs. Collective."""
        r = _dolfinx.create_vector(self.V)
        term.add_residual(self.x, None, r, None)
        add_ghosts(r)
        return r

    def slope(self, term, h=1e-5):
        """The central difference of a term's energy along the displacement. Collective."""
        energies = []
        for sign in (1, -1):
            moved = self.x.copy()
            moved.scale(1 + sign * h)
            update_ghosts(moved)
            energies.append(term.energy(moved, None))
        return (energies[0] - energies[1]) / (2 * h)


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("cell, degree", [("hexahedron", 1), ("tetrahedron", 2)])
def test_exact_hessian_is_that_of_dolfinx(comm, cell, degree):
    body = Body(comm, cell, degree)
    energy = body.mixed_energy()
    term, matrix = UFLTerm(energy, body.u), DenseMatrix(body.V)
    for value in (3.0, 5.0):  # a constant may change
        body.k.value = value
        matrix.values[:] = 0
        assert term.add_hessian(body.x, None, "exact", matrix) == 0
        expected = body.dolfinx_jacobian(ufl.derivative(energy, body.u))
        assert abs(matrix.total() - expected).max() < 1e-13 * abs(expected).max()
    assert term.has_energy and not term.depends_on_load
    expected = _dolfinx.assemble_scalar(_dolfinx.form(energy))
    assert term.energy(body.x, None) == pytest.approx(expected, rel=1e-13)
    assert body.residual(term).dot(body.x) == pytest.approx(body.slope(term), rel=1e-7)


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("filter", ["clamp", "abs"])
def test_element_matrices_are_filtered_by_their_eigenvalues(comm, filter):
    body = Body(comm)
    term = UFLTerm(body.mixed_energy(), body.u)
    exact, filtered = DenseMatrix(body.V), DenseMatrix(body.V)
    term.add_hessian(body.x, None, "exact", exact)
    count = term.add_hessian(body.x, None, filter, filtered)
    indefinite = 0
    for K, found in zip(exact.matrices, filtered.matrices, strict=True):
        values, vectors = np.linalg.eigh(K)
        kept = np.maximum(values, 0) if filter == "clamp" else abs(values)
        assert abs(found - (vectors * kept) @ vectors.T).max() < 1e-9 * abs(K).max()
        indefinite += values[0] < -1e-9 * abs(K).max()
    assert count == indefinite
    assert 0 < comm.allreduce(count) < comm.allreduce(len(exact.matrices))
    least = np.linalg.eigvalsh(filtered.total())[0]
    assert least > -1e-12 > np.linalg.eigvalsh(exact.total())[0]


@mpi
def test_residuals(comm):
    """Which have an energy: dead loads and linear symmetric ones; slopes of those energies."""
    body = Body(comm)
    u, v, k = body.u, body.v, body.k
    force = ufl.inner(k * ufl.as_vector([1, 2, 3]), v) * body.ds
    forms = {
        "dead load": (force, True),
        "springs": (k * ufl.inner(u, v) * body.ds + force, True),
        "asymmetric": (u[0] * v[1] * body.dx, False),
        "nonlinear": (ufl.inner(u, u) * v[0] * body.dx, False),
    }
    for name, (form, has_energy) in forms.items():
        term = UFLTerm(form, u, name)
        assert term.has_energy == has_energy, name
        r = body.residual(term)
        expected = _dolfinx.create_vector(body.V)
        _dolfinx.assemble_vector(expected, _dolfinx.form(form))
        expected.axpy(-1.0, r)
        assert expected.norm() < 1e-14 * r.norm()
        if has_energy:
            assert body.slope(term) == pytest.approx(r.dot(body.x), rel=1e-8)
        else:
            with pytest.raises(BadInput, match=f"'{name}' has no energy"):
                term.energy(body.x, None)


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("filter", ["exact", "clamp"])
def test_jacobian_of_an_asymmetric_residual(comm, filter):
    """It is that of dolfinx, and of its symmetric part where eigenvalues are filtered."""
    body = Body(comm)
    form = (body.u[0] * body.v[1] + 2 * ufl.inner(body.u, body.v)) * body.dx
    matrix, term = DenseMatrix(body.V), UFLTerm(form, body.u)
    assert not term.symmetric
    term.add_hessian(body.x, None, filter, matrix)
    K = body.dolfinx_jacobian(form)
    assert abs(K - K.T).max() > 1e-3
    expected = K if filter == "exact" else (K + K.T) / 2
    assert abs(matrix.total() - expected).max() < 1e-14
