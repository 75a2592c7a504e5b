"""The SSOR preconditioner in single precision, in PETSc's own solvers."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from plane_programs import COMPONENTS, clamped
from test_eisenstat import body, right_side

from fem_snh.linalg.ssor_cg import SSOR

mpi = pytest.mark.mpi
Reason = PETSc.KSP.ConvergedReason


def solver(A, kind="stcg"):
    """A KSP with SSOR."""
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOperators(A)
    ksp.setType(kind)
    ksp.getPC().setType("python")
    ksp.getPC().setPythonContext(SSOR())
    ksp.setTolerances(rtol=1e-8, atol=0.0, max_it=2000)
    return ksp


@mpi
@pytest.mark.parametrize("kinematics", ["3D", *COMPONENTS])
def test_it_is_ssor_of_each_ranks_rows(comm, kinematics):
    """M = (D + L) D^-1 (D + L)^T to single precision.

    D is the blocks on the diagonal, plus 0.35 times the sums of what couples a row to other ranks
    (docs/theory/linear_solver.md).
    """
    p = body(comm, cells=3) if kinematics == "3D" else clamped(comm, kinematics)
    A, ksp = p.A, solver(p.A)
    assert A.getBlockSize() == COMPONENTS.get(kinematics, 3)
    first, last = A.getOwnershipRange()
    own = np.arange(first, last, dtype=PETSc.IntType)
    all_columns = np.arange(A.getSize()[1], dtype=PETSc.IntType)
    values = A.getValues(own, all_columns)
    rows, others = values[:, own], np.delete(values, own, axis=1)
    block = (own - first) // A.getBlockSize()
    shift = np.diag(0.35 * np.abs(others).sum(axis=1))
    D = np.where(block[:, None] == block, rows, 0.0) + shift
    lower = np.where(block[:, None] >= block, rows, 0.0) + shift
    x, y = A.createVecs()
    x.setRandom()
    ksp.getPC().setUp()
    ksp.getPC().apply(x, y)
    exact = np.linalg.solve(lower.T, D @ np.linalg.solve(lower, x.array))
    assert np.abs(y.array - exact).max() <= 1e-4 * np.abs(exact).max()


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("E", [1e-30, 1.0, 1e30])
def test_conjugate_gradients_converge_in_any_unit(comm, E):
    """The residual falls below single precision, as only the preconditioner is single."""
    p = body(comm, E=E)
    b, x = right_side(p), p.x.duplicate()
    ksp = solver(p.A)
    ksp.solve(b, x)
    r = b.duplicate()
    p.A.mult(x, r)
    r.axpy(-1.0, b)
    assert ksp.getConvergedReason() == Reason.CONVERGED_RTOL
    assert r.norm() <= 1e-6 * b.norm()
