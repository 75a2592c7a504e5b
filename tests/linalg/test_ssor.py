"""The SSOR preconditioner in single precision, in PETSc's own solvers."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from bodies import dense
from plane_programs import COMPONENTS, clamped
from test_eisenstat import body, right_side

from fem_snh.linalg.ssor_cg import SSOR, SSORSystem

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
def test_it_is_ssor_of_all_ranks_rows(comm, kinematics):
    """M = (D + L) D^-1 (D + L)^T to single precision, in the order of the sweeps.

    The rows that are coupled to higher ranks alone come first, other rows that are coupled to other
    ranks last. M omits couplings of two last rows of different ranks; D has 0.35 times the sums of
    their absolute values (docs/theory/linear_solver.md).
    """
    p = body(comm, cells=3) if kinematics == "3D" else clamped(comm, kinematics)
    A, ksp = p.A, solver(p.A)
    size = A.getBlockSize()
    assert size == COMPONENTS.get(kinematics, 3)
    matrix, ranges = dense(A), A.getOwnershipRanges()
    rank = np.searchsorted(ranges, np.arange(len(matrix)), side="right") - 1
    block = np.arange(len(matrix)) // size
    coupled = np.zeros((block[-1] + 1,) * 2, bool)  # by a cell, whether or not an entry is zero
    indptr, indices = _pattern(A)
    coupled[np.repeat(block, np.diff(indptr)), block[indices]] = True
    of_block = rank[::size]
    lower = (coupled & (of_block < of_block[:, None])).any(axis=1)
    higher = (coupled & (of_block > of_block[:, None])).any(axis=1)
    stage = np.where(lower, 2, np.where(higher, 0, 1))
    omitted = coupled & (of_block != of_block[:, None]) & (stage == 2) & (stage[:, None] == 2)
    assert comm.size == 1 or (stage == 0).any()
    omitted = np.kron(omitted, np.ones((size, size), bool))
    shift = np.diag(0.35 * np.abs(np.where(omitted, matrix, 0.0)).sum(axis=1))
    position = np.empty(len(stage))
    position[np.lexsort((np.arange(len(stage)), stage))] = np.arange(len(stage))
    row, column = position[block][:, None], position[block]
    D = np.where(row == column, matrix, 0.0) + shift
    lower = np.where((row >= column) & ~omitted, matrix, 0.0) + shift
    x, y = A.createVecs()
    x.setRandom()
    ksp.getPC().setUp()
    ksp.getPC().apply(x, y)
    given, found = (np.concatenate(comm.allgather(v.array)) for v in (x, y))
    exact = np.linalg.solve(lower.T, D @ np.linalg.solve(lower, given))
    assert np.abs(found - exact).max() <= 1e-4 * np.abs(exact).max()


def _pattern(A):
    """Return (indptr, indices) of the whole matrix on every rank."""
    start, columns, _ = A.getValuesCSR()
    counts = np.concatenate(A.comm.tompi4py().allgather(np.diff(start)))
    indices = np.concatenate(A.comm.tompi4py().allgather(columns))
    return np.concatenate([[0], np.cumsum(counts)]), indices


@mpi
@pytest.mark.parametrize("kinematics", ["3D", *COMPONENTS])
def test_the_copy_adds_up_the_energies_of_translations_in_double_precision(comm, kinematics):
    """They decide whether single precision loses the motion of an almost free body."""
    p = body(comm, cells=3) if kinematics == "3D" else clamped(comm, kinematics)
    system, size = SSORSystem(p.A, None), p.A.getBlockSize()
    system.update(p.A)
    found = comm.allreduce(system.matrix.translations)
    x, y = p.A.createVecs()
    for k in range(size):
        x.set(0.0)
        x.array[k::size] = 1.0
        p.A.mult(x, y)
        assert found[k] == pytest.approx(system.scale * x.dot(y), rel=1e-11)


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
