"""Factors of small matrices: PETSc's while these are positive definite, then those by MUMPS."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

import fem_snh
from fem_snh._petsc import factors_out_of_memory, negative_pivots, set_operators
from fem_snh.linalg.direct_solver import is_direct, set_direct_solver

PETSC, MUMPS = PETSc.Mat.SolverType.PETSC, PETSc.Mat.SolverType.MUMPS


def matrix(values):
    """Return a matrix of PETSc's of all entries of an array."""
    n = len(values)
    indptr, indices = np.arange(0, n * n + 1, n), np.tile(np.arange(n), n)
    csr = tuple(a.astype(PETSc.IntType) for a in (indptr, indices))
    A = PETSc.Mat().createAIJ((n, n), csr=(*csr, values.ravel()), comm=PETSc.COMM_SELF)
    A.assemble()
    return A


def solve(ksp, values):
    """Return the solution for a right-hand side of the matrix's scale, and the package's name."""
    A, scale = matrix(values), np.abs(values).max()
    set_operators(ksp, A, A)
    b, x = A.createVecs()
    b.array = scale * np.arange(1, len(values) + 1)
    ksp.solve(b, x)
    return np.array(x), ksp.getPC().getFactorSolverType()


def small_solver():
    """Return a new solver for small matrices."""
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    set_direct_solver(ksp, small=True)
    return ksp


def spectrum(values, seed):
    """Return a symmetric matrix with these eigenvalues."""
    Q = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(values), len(values))))[0]
    A = Q * np.array(values) @ Q.T
    return (A + A.T) / 2


@pytest.mark.one_debian
@given(
    st.lists(st.floats(1e-6, 1.0), min_size=2, max_size=12),
    st.sampled_from([1e-30, 1e-8, 1.0, 1e30]),
    st.integers(0, 9),
)
def test_definite_matrices_of_every_scale(values, scale, seed):
    """No pivot counts as zero by its units."""
    A, ksp = scale * spectrum(values, seed), small_solver()
    x, package = solve(ksp, A)
    b = np.abs(A).max() * np.arange(1, len(values) + 1)
    backward = np.abs(A @ x - b).max() / (np.abs(A).sum(axis=1).max() * np.abs(x).max())
    assert package == PETSC and negative_pivots(ksp.getPC()) == 0 and is_direct(ksp)
    assert backward < 1e-14


@pytest.mark.parametrize("first", [0.0, 1e-18, -1.0, 1.0])
def test_mumps_takes_over_at_the_first_indefinite_matrix(first):
    """The first pivot may be zero, tiny, negative, or the last negative alone; and it stays."""
    A = np.array([[first, 1.0, 0.5], [1.0, 0.2, 0.3], [0.5, 0.3, 2.0]])
    ksp = small_solver()
    assert solve(ksp, np.diag([1.0, 2.0, 3.0]))[1] == PETSC
    x, package = solve(ksp, A)
    assert package == MUMPS and is_direct(ksp)
    assert negative_pivots(ksp.getPC()) == (np.linalg.eigvalsh(A) < 0).sum() == 1
    np.testing.assert_allclose(A @ x, np.abs(A).max() * np.arange(1, 4), rtol=1e-12)
    x, package = solve(ksp, np.diag([1.0, 2.0, 4.0]))
    assert package == MUMPS and negative_pivots(ksp.getPC()) == 0
    np.testing.assert_allclose(x, [4, 4, 3], rtol=1e-14)


@pytest.mark.one_debian
@pytest.mark.parametrize("hessian", ["adaptive", "exact"])
@pytest.mark.parametrize("scene", ["cook", "column"])
def test_the_equilibrium_is_that_of_mumps(scene, hessian):
    """Of a membrane, and of a strip that buckles, where the exact Hessian is indefinite."""
    given = {"element": "Q1", "progress": False, "nu": 0.45}
    if scene == "cook":
        given |= {"cells": 8, "kinematics": "plane_strain"}
    else:
        given |= {"scene": "stretch", "cells": 4, "kinematics": "plane_strain", "stretch": 0.6}
        given |= {"aspect": 8.0}
    scene = given.pop("scene", "cook")
    found = []
    for package in (None, "mumps"):
        petsc = {"snes_scaled_tol": 1e-11, "snes_hessian": hessian}
        petsc |= {"pc_factor_mat_solver_type": package} if package else {}
        found.append(fem_snh.run(scene, petsc=petsc, **given))
    ours, mumps = found
    assert ours.converged and mumps.converged
    assert ours.steps[-1]["energy"] == pytest.approx(mumps.steps[-1]["energy"], rel=1e-10)
    assert [s["newton"] for s in ours.steps] == [s["newton"] for s in mumps.steps]


@pytest.mark.parametrize("limit", [0, 1])
def test_more_workspace_where_pivoting_needs_it(limit):
    """Of a saddle point: MUMPS 5.5, without any to spare, ends with INFOG(1) = -9.

    Factors that exceed the memory that the user allows [MB] are out of memory.
    """
    n, m = 400, 300
    K = sp.random(n, n, density=4 / n, random_state=2)
    B = sp.random(m, n, density=3 / n, random_state=1) + sp.eye(m, n)
    S = (sp.bmat([[K + K.T, B.T], [B, None]]) + 0.0 * sp.eye(n + m)).tocsr()
    if limit:  # its factors are larger than a MB
        S = sp.kron(sp.eye(20), S).tocsr()
    csr = (S.indptr.astype(PETSc.IntType), S.indices.astype(PETSc.IntType), S.data)
    A = PETSc.Mat().createAIJ(S.shape, csr=csr, comm=PETSc.COMM_SELF)

    def without_spare():
        ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        set_direct_solver(ksp)
        ksp.setOperators(A, A)
        ksp.getPC().setFactorSetUpSolverType()
        ksp.getPC().getFactorMatrix().setMumpsIcntl(14, 0)
        ksp.getPC().getFactorMatrix().setMumpsIcntl(23, limit)
        return ksp

    plain, ksp = without_spare(), without_spare()
    plain.setUp()
    lacks = plain.getPC().getFactorMatrix().getMumpsInfog(1) == -9
    set_operators(ksp, A, A)
    assert factors_out_of_memory(ksp.getPC()) == bool(limit)
    if not limit:
        b, x = A.createVecs()
        b.array = S @ np.ones(n + m)
        ksp.solve(b, x)
        assert (ksp.getPC().getFactorMatrix().getMumpsIcntl(14) > 0) == lacks
        assert np.abs(S @ x.array_r - b.array_r).max() < 1e-8
