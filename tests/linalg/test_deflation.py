"""Deflated conjugate gradients: subdomains, linear functions, coarse matrix, convergence."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from bodies import dense
from plane_programs import COMPONENTS, clamped
from test_eisenstat import Reason, body, right_side, solve

from fem_snh._petsc import default_options
from fem_snh.linalg.deflation import linear_functions
from fem_snh.linalg.ssor_cg import EisenstatCG

mpi = pytest.mark.mpi


@pytest.fixture
def subdomains(request):
    """The number of deflation subdomains, set as a PETSc option."""
    with default_options("", {"ksp_deflation_subdomains": request.param}):
        yield request.param


def with_subdomains(*counts):
    """Parametrise a test by the number of subdomains."""
    return pytest.mark.parametrize("subdomains", counts, indirect=True)


# --- subdomains and functions --------------------------------------------------------------------


@pytest.mark.parametrize(("shape", "functions"), [((1, 1, 1), 4), ((1, 1, 0), 3), ((0, 0, 0), 1)])
def test_functions_are_orthonormal_and_span_the_linear_ones(shape, functions):
    x = 5.0 + np.random.default_rng(1).random((60, 3)) * shape
    free = np.ones((60, 3), bool)
    free[:7, 1] = False
    values = linear_functions(x, np.repeat([0, 1], 30), free).astype(float)
    assert not values[:7, 1].any()
    for nodes in (slice(0, 30), slice(30, 60)):
        for k in range(3):
            G = values[nodes, k]
            product = G.T @ G
            assert np.allclose(
                product, np.diag([1.0] * functions + [0.0] * (4 - functions)), atol=1e-6
            )
            wanted = np.where(free[nodes, k], x[nodes] @ (1.0, -2.0, 3.0) + 4.0, 0.0)
            assert np.allclose(G @ (G.T @ wanted), wanted, atol=1e-5)


# --- the coarse matrix ---------------------------------------------------------------------------


@with_subdomains(6, 80)
def test_the_coarse_matrix_is_the_galerkin_product(comm, subdomains):
    p = body(comm)
    ours = EisenstatCG(p.coordinates)
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(p.A)
    ours.create(ksp)
    ours.setFromOptions(ksp)
    ours.update_matrix(p.A)
    deflation = ours._system.deflation
    A = dense(p.A) * ours._system.scale
    rows = len(p.coordinates)
    Z = np.zeros((rows, 3, subdomains, 3, 4))
    for k in range(3):
        Z[np.arange(rows), k, deflation.subdomain, k] = deflation.functions[:, k]
    Z = Z.reshape(3 * rows, 12 * subdomains)
    AZ = np.zeros((rows, 3, subdomains, 12))
    start, near, image = (deflation.arrays[k] for k in ("pair_start", "pair_subdomain", "image"))
    for i in range(rows):
        AZ[i][:, near[start[i] : start[i + 1]]] = image[start[i] : start[i + 1]].swapaxes(0, 1)
    assert np.allclose(AZ.reshape(Z.shape), A @ Z, atol=1e-6 * np.abs(A @ Z).max())
    E = Z.T @ A @ Z
    # Some functions are zero where a subdomain has few nodes.
    assert np.allclose(E @ [deflation.E.solve(row) for row in E], E, atol=1e-8)


# --- convergence ---------------------------------------------------------------------------------


@pytest.mark.one_debian
@mpi
@with_subdomains(24)
def test_iterations_are_halved(comm, subdomains):
    p = body(comm, cells=12)
    ksp, x, residual = solve(p, right_side(p), rtol=1e-6)
    PETSc.Options()["ksp_deflation_subdomains"] = 0
    plain, y, _ = solve(p, right_side(p), rtol=1e-6)
    assert ksp.getIterationNumber() < 0.5 * plain.getIterationNumber()
    assert residual < 1e-5
    y.axpy(-1.0, x)
    assert y.norm() < 1e-4 * x.norm()


@mpi
@with_subdomains(24)
def test_ranks_add_few_iterations(comm, subdomains):
    """Sweeps are within each rank; the shift of D makes up for most of what they leave out."""
    alone, together = (body(of, cells=12) for of in (MPI.COMM_SELF, comm))
    one, several = (solve(p, right_side(p), rtol=1e-6)[0] for p in (alone, together))
    assert several.getIterationNumber() <= 1.2 * one.getIterationNumber()


@pytest.mark.one_debian("ranks")
@mpi
@with_subdomains(0, 1, 5, 60, 80)
@pytest.mark.parametrize("hold", [(), ("x",), ("x", "z")])
def test_unconstrained_rigid_motions(comm, subdomains, hold):
    """Matrix and coarse matrix are singular; a right-hand side in their range is solved for."""
    p = body(comm, hold=hold, size=0.0)
    b, x = p.x.duplicate(), p.x.duplicate()
    x.array[:] = np.sin(7.0 * p.coordinates).ravel()
    p.prescribe(x)
    p.A.mult(x, b)
    ksp, y, residual = solve(p, b, rtol=1e-5)
    assert ksp.getConvergedReason() > 0 and residual < 3e-5
    assert y.norm() < 1.5 * x.norm()  # rigid motions are left out


@mpi
@with_subdomains(5, 80)
def test_negative_curvature_of_the_coarse_matrix_ends_a_solve(comm, subdomains):
    """Rotations of a compressed subdomain have negative curvature: no iteration is needed."""
    p = body(comm, size=0.0, hold=())
    x = p.x.duplicate()
    x.array[:] = (-0.4 * p.coordinates).ravel()
    p.jacobian(x, "exact")
    p.x.set(1.0)
    ksp, y, _ = solve(p, p.x)
    assert ksp.getConvergedReason() == Reason.DIVERGED_INDEFINITE_MAT
    assert ksp.getIterationNumber() == 0 and y.norm() == 0


@pytest.mark.one_debian("ranks")
@mpi
@with_subdomains(5)
def test_the_constrained_unknowns_may_change(comm, subdomains):
    """Z is zero on unknowns that the matrix couples to no other, and follows their changes."""
    p = body(comm)
    b = right_side(p)
    ksp = solve(p, b)[0]
    first = p.A.getOwnershipRange()[0]
    rows = np.arange(first + 30, first + 33, dtype=PETSc.IntType)
    p.A.zeroRowsColumns(rows, diag=2.0)
    x, r = b.duplicate(), b.duplicate()
    ksp.setTolerances(rtol=1e-8)
    ksp.solve(b, x)
    p.A.mult(x, r)
    r.axpy(-1.0, b)
    assert r.norm() < 1e-6 * b.norm()
    assert x.array[30:33] == pytest.approx(b.array[30:33] / 2, rel=1e-5)


@mpi
@with_subdomains(1)
def test_a_solution_in_the_coarse_space_needs_no_iterations(comm, subdomains):
    """A uniform strain of a free body is in the range of Z, on any number of ranks."""
    p = body(comm, size=0.0, hold=())
    x, b = p.x.duplicate(), p.x.duplicate()
    x.array[:] = (p.coordinates * (0.3, -0.1, 0.0)).ravel()
    p.A.mult(x, b)
    ksp, _, residual = solve(p, b)
    if comm.size == 1:
        assert ksp.getIterationNumber() <= 1
    assert ksp.getConvergedReason() > 0 and residual < 1e-3


# --- meshes of two dimensions --------------------------------------------------------------------


@with_subdomains(1)
@pytest.mark.parametrize("kinematics", COMPONENTS)
def test_linear_motions_of_a_section_are_in_the_coarse_space(subdomains, kinematics):
    """A free section that is strained, moved and turned needs no iteration."""
    p = clamped(MPI.COMM_SELF, kinematics, cells=8, hold=False)
    X, components = p.coordinates, COMPONENTS[kinematics]
    motion = {
        "plane_strain": np.stack([1 - 0.3 * X[:, 1], 2 + 0.1 * X[:, 0]], axis=1),
        "axisymmetric": np.stack([0.2 * X[:, 0], 1 - 0.1 * X[:, 1]], axis=1),
        "axisymmetric_torsion": np.stack([0.2 * X[:, 0], X[:, 1], 0.3 * X[:, 0]], axis=1),
    }[kinematics]
    assert motion.shape[1] == components
    x, b = p.x.duplicate(), p.x.duplicate()
    x.array[:] = motion.ravel()
    p.A.mult(x, b)
    ksp, _, residual = solve(p, b)
    assert ksp.getIterationNumber() <= 1 and ksp.getConvergedReason() > 0 and residual < 1e-3
