"""Conjugate gradients for many right-hand sides, against numpy's dense solver."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest

from fem_snh.linalg.columns_cg import LANES, ColumnsCG

mpi = pytest.mark.mpi
SIZE = 24


def dense(shift=0.0):
    """A symmetric matrix whose rows couple all ranks; ``shift`` is taken off its diagonal."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(SIZE, SIZE)) * (rng.random((SIZE, SIZE)) < 0.2)
    scale = np.diag(10.0 ** rng.uniform(-3, 3, SIZE))
    return scale @ (root @ root.T + (1 - shift) * np.eye(SIZE)) @ scale


def distributed(comm, A):
    """The AIJ matrix, and this rank's rows as a slice."""
    matrix = PETSc.Mat().createAIJ((SIZE, SIZE), comm=comm)
    matrix.setUp()
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    own = slice(*matrix.getOwnershipRange())
    for i in range(own.start, own.stop):
        columns = np.flatnonzero(A[i]).astype(np.int32)
        matrix.setValues(i, columns, A[i, columns])
    matrix.assemble()
    return matrix, own


@pytest.mark.one_debian("ranks")
@mpi
def test_columns_are_solved_to_the_tolerance(comm):
    A = dense()
    exact = np.random.default_rng(5).normal(size=(2, SIZE, LANES)) * 10.0 ** np.arange(-4, 4)
    exact[1, :, 3:] = 0  # the padding of the last block
    b = A @ exact
    matrix, own = distributed(comm, A)
    found = b[:, own].copy()
    solver = ColumnsCG(matrix, 1e-14)
    solver.solve(found)
    scale = np.sqrt(np.diag(A))[:, None]  # of the unknowns: those of A have six orders of magnitude
    errors = abs(found - exact[:, own]) * scale[own]
    assert (errors <= 1e-11 * abs(exact * scale).max(axis=1, keepdims=True)).all()
    assert not found[1, :, 3:].any() and 3 < solver.iterations <= 2 * SIZE


@mpi
def test_a_column_without_a_solution_is_nan_and_the_others_are_not(comm):
    A = dense()
    b = np.ones((1, SIZE, LANES))
    b[0, 7, 2], b[0, 9, 5] = np.nan, np.inf
    matrix, own = distributed(comm, A)
    found = b[:, own].copy()
    ColumnsCG(matrix, 1e-14).solve(found)
    bad = np.isin(np.arange(LANES), [2, 5])
    assert np.isnan(found[..., bad]).all() and np.isfinite(found[..., ~bad]).all()

    indefinite, own = distributed(comm, dense(shift=1.5))
    found = b[:, own].copy()
    ColumnsCG(indefinite, 1e-14).solve(found)
    assert np.isnan(found).all()
