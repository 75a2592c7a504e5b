"""Several right-hand sides at once: conjugate gradients in lanes, and GMRES with blocks."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from bodies import dense, wave
from plane_programs import clamped
from test_eisenstat import body
from volume_energies import mixed_problem, set_state

from fem_snh import solver
from fem_snh._petsc import default_options
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.solver.block_triangular import solve_columns

mpi = pytest.mark.mpi


def conjugate_gradients(p, subdomains):
    """Return `EisenstatCG` with the matrix of a problem."""
    with default_options("", {"ksp_deflation_subdomains": subdomains}):
        ksp = PETSc.KSP().create(p.A.comm)
        ksp.setType("python")
        ksp.setPythonContext(EisenstatCG(p.coordinates[:, : p.regime.dimension]))
        ksp.setFromOptions()
    cg = ksp.getPythonContext()
    cg.update_matrix(p.A)
    return ksp, cg


def right_sides(p, count, seed=0):
    """Return random vectors, zero where the problem is constrained."""
    vectors = []
    for k in range(count):
        b = p.x.duplicate()
        b.array[:] = np.random.default_rng([seed, k, b.comm.rank]).standard_normal(len(b.array_r))
        p.project(b.array)
        vectors.append(b)
    return vectors


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("subdomains", [0, 5, 80])
@pytest.mark.parametrize("plane", [False, True])
def test_each_column_has_its_solution_and_its_residual(comm, subdomains, plane):
    """Ten columns, more than lanes, of which one is zero and one is large."""
    p = clamped(comm, "plane_strain", cells=12) if plane else body(comm)
    b = right_sides(p, 10)
    b[3].set(0.0)
    b[4].scale(1e30)
    _, cg = conjugate_gradients(p, subdomains)
    found = cg.solve_columns(np.stack([v.array_r for v in b]), 1e-4, 500)
    assert not found.indefinite
    product = b[0].duplicate()
    for x, r, column in zip(found.x, found.residual, b, strict=True):
        solution, residual = column.duplicate(), column.duplicate()
        solution.array[:], residual.array[:] = x, r
        p.A.mult(solution, product)
        size = column.norm()
        assert (column - product).norm() <= 1e-3 * size
        assert (column - product - residual).norm() <= 5e-5 * size


@mpi
@pytest.mark.parametrize("subdomains", [0, 5])
def test_a_matrix_with_negative_eigenvalues_is_indefinite(comm, subdomains):
    p = body(comm, size=0.0)
    x = p.x.duplicate()
    x.array[:] = (-0.6 * p.coordinates).ravel()
    p.jacobian(x, "exact")
    _, cg = conjugate_gradients(p, subdomains)
    b = np.stack([v.array_r for v in right_sides(p, 3)])
    assert cg.solve_columns(b, 1e-6, 500).indefinite


@mpi
def test_free_rigid_motions_are_no_negative_curvature(comm):
    p = body(comm, size=0.0, hold=())
    b = right_sides(p, 2)
    for v, x in zip(b, right_sides(p, 2, seed=1), strict=True):
        p.A.mult(x, v)
    _, cg = conjugate_gradients(p, 5)
    found = cg.solve_columns(np.stack([v.array_r for v in b]), 1e-4, 500)
    assert not found.indefinite and np.isfinite(found.x).all()


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q2Q1", "P2P0"])
def test_blocks_have_the_solutions_of_factors(comm, element):
    """Also of right-hand sides that are combinations of others."""
    problem = set_state(mixed_problem(comm, element), wave(0.05))
    problem.jacobian(problem.x, "clamp")
    problem.saddle_point.update_schur_approximation(problem.A)
    snes = solver.create(problem)  # its KSP calls it
    ksp = snes.getKSP()
    ksp.setOperators(problem.A, problem.A)
    ksp.setTolerances(rtol=1e-3)
    ksp.setUp()
    b = right_sides(problem, 4)
    b.append(b[0] - 2.0 * b[1])
    found, iterations = solve_columns(ksp.getPC().getPythonContext(), b, ksp)
    single = []
    for x, v in zip(found, b, strict=True):
        assert (problem.A * x - v).norm() <= 2e-3 * v.norm()
        z = v.duplicate()
        ksp.solve(v, z)
        single.append(ksp.getIterationNumber())
    assert iterations <= max(single) + 1
    solver.destroy(snes)
    A, last = dense(problem.A), dense_vector(b[-1])
    expected = np.linalg.lstsq(A, last, rcond=None)[0]
    assert np.linalg.norm(A @ expected - last) < 1e-8 * np.linalg.norm(last)
    assert np.linalg.norm(dense_vector(found[-1]) - expected) < 0.02 * np.linalg.norm(expected)


def dense_vector(x):
    """Return all entries of a vector on every rank."""
    return np.concatenate(x.comm.tompi4py().allgather(x.array_r))
