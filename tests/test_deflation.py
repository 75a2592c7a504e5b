"""The coarse space that conjugate gradients are spared."""

from __future__ import annotations

from itertools import pairwise

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from bodies import dense
from hypothesis import given
from hypothesis import strategies as st
from test_eisenstat import Reason, body, right_side, solve

from fem_snh._petsc import default_options
from fem_snh.linalg.coarse_space import MODES, bisect, linear
from fem_snh.solver import EisenstatCG

mpi = pytest.mark.mpi


@pytest.fixture
def parts(request):
    """The option that says how many parts there are."""
    with default_options("", {"ksp_deflation_subdomains": request.param}):
        yield request.param


def some(*counts):
    return pytest.mark.parametrize("parts", counts, indirect=True)


# --- parts and functions -------------------------------------------------------------------------


@given(st.integers(1, 200), st.integers(1, 40), st.integers(0, 9))
def test_parts_have_as_many_nodes_each(nodes, parts, seed):
    parts = min(nodes, parts)
    counts = np.bincount(bisect(np.random.default_rng(seed).random((nodes, 3)), parts))
    assert len(counts) == parts and counts.min() >= 1
    assert np.abs(counts - counts.mean()).max() < 2  # a split rounds, and the next halves that


def test_parts_are_boxes():
    """Cut across where they are longest: of a bar, slices."""
    x = np.random.default_rng(0).random((400, 3)) * (8, 1, 1)
    part = bisect(x, 4)
    ends = sorted((x[part == k, 0].min(), x[part == k, 0].max()) for k in range(4))
    assert all(one[1] < other[0] for one, other in pairwise(ends))


@pytest.mark.parametrize(("shape", "functions"), [((1, 1, 1), 4), ((1, 1, 0), 3), ((0, 0, 0), 1)])
def test_functions_are_orthonormal_and_span_what_is_linear(shape, functions):
    x = 5.0 + np.random.default_rng(1).random((60, 3)) * shape
    free = np.ones((60, 3), bool)
    free[:7, 1] = False
    modes = linear(x, np.repeat([0, 1], 30), free).astype(float)
    assert not modes[:7, 1].any()
    for part in (slice(0, 30), slice(30, 60)):
        for k in range(3):
            G = modes[part, k]
            product = G.T @ G
            assert np.allclose(
                product, np.diag([1.0] * functions + [0.0] * (4 - functions)), atol=1e-6
            )
            wanted = np.where(free[part, k], x[part] @ (1.0, -2.0, 3.0) + 4.0, 0.0)
            assert np.allclose(G @ (G.T @ wanted), wanted, atol=1e-5)


# --- the matrix and its coarse one ---------------------------------------------------------------


@some(6)
def test_the_coarse_matrix_is_that_of_the_fine_one(comm, parts):
    p = body(comm)
    ours = EisenstatCG(p.coordinates)
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(p.A)
    ours.create(ksp)
    ours.setFromOptions(ksp)
    ours.update_matrix(p.A)
    deflation = ours._deflation
    coarse, A = deflation._coarse, dense(p.A) * ours._scale
    rows = len(p.coordinates)
    Z = np.zeros((rows, 3, parts, 3, 4))
    for k in range(3):
        Z[np.arange(rows), k, coarse.part, k] = coarse.modes[:, k]
    Z = Z.reshape(3 * rows, MODES * parts)
    AZ = np.zeros((rows, 3, parts, MODES))
    start, near, image = coarse._kept[3:6]
    for i in range(rows):
        AZ[i][:, near[start[i] : start[i + 1]]] = image[start[i] : start[i + 1]].swapaxes(0, 1)
    assert np.allclose(AZ.reshape(Z.shape), A @ Z, atol=1e-6 * np.abs(A @ Z).max())
    E = Z.T @ A @ Z
    assert np.linalg.eigvalsh(E)[0] > 0
    assert np.allclose(deflation._inverse @ E, np.eye(len(E)), atol=1e-8)


# --- what it is for ------------------------------------------------------------------------------


@mpi
@some(24)
def test_iterations_are_a_part_of_those_without(comm, parts):
    p = body(comm, cells=12)
    ksp, x, residual = solve(p, right_side(p), rtol=1e-6)
    PETSc.Options()["ksp_deflation_subdomains"] = 0
    plain, y, _ = solve(p, right_side(p), rtol=1e-6)
    assert ksp.getIterationNumber() < 0.5 * plain.getIterationNumber()
    assert residual < 1e-5
    y.axpy(-1.0, x)
    assert y.norm() < 1e-4 * x.norm()


@mpi
@some(-1)
def test_small_bodies_have_no_parts(comm, parts):
    """By default, and 0 says so of any."""
    p = body(comm)
    default = solve(p, right_side(p))[0].getIterationNumber()
    PETSc.Options()["ksp_deflation_subdomains"] = 0
    assert solve(p, right_side(p))[0].getIterationNumber() == default


@mpi
@some(0, 1, 5, 60)
@pytest.mark.parametrize("hold", [(), ("x",), ("x", "z")])
def test_motions_that_nothing_holds(comm, parts, hold):
    """The matrix is singular, and so is the coarse one; forces that do not excite them are met."""
    p = body(comm, hold=hold, size=0.0)
    b, x = p.x.duplicate(), p.x.duplicate()
    x.array[:] = np.sin(7.0 * p.coordinates).ravel()
    p.prescribe(x)
    p.A.mult(x, b)
    ksp, y, residual = solve(p, b, rtol=1e-5)
    assert ksp.getConvergedReason() > 0 and residual < 1e-4
    assert y.norm() < 100 * x.norm()


@mpi
@some(5)
def test_negative_curvature_of_the_coarse_matrix_ends_a_solve(comm, parts):
    """Rotations of a part are downhill where it is pressed; the solve need not begin."""
    p = body(comm, size=0.0, hold=())
    x = p.x.duplicate()
    x.array[:] = (-0.4 * p.coordinates).ravel()
    p.jacobian(x, "exact")
    p.x.set(1.0)
    ksp, y, _ = solve(p, p.x)
    assert ksp.getConvergedReason() == Reason.DIVERGED_INDEFINITE_MAT
    assert ksp.getIterationNumber() == 0 and y.norm() == 0


@mpi
@some(5)
def test_values_that_are_no_numbers_beside_the_diagonal(comm, parts):
    p = body(comm)
    b = right_side(p)
    first = p.A.getOwnershipRange()[0]
    p.A.setValue(first + 30, first + 33, np.nan)
    p.A.assemble()
    ksp, *_ = solve(p, b)
    assert ksp.getConvergedReason() == Reason.DIVERGED_NANORINF


@mpi
@some(5)
def test_what_is_prescribed_may_change(comm, parts):
    """Functions are zero on what the matrix couples to nothing; they follow it."""
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
@some(1)
def test_what_the_coarse_space_has_takes_no_iterations(comm, parts):
    """A stretch of a body that nothing holds is one of its functions, on any number of ranks."""
    p = body(comm, size=0.0, hold=())
    x, b = p.x.duplicate(), p.x.duplicate()
    x.array[:] = (p.coordinates * (0.3, -0.1, 0.0)).ravel()
    p.A.mult(x, b)
    ksp, _, residual = solve(p, b)
    if comm.size == 1:
        assert ksp.getIterationNumber() <= 1
    assert ksp.getConvergedReason() > 0 and residual < 1e-3


@mpi
@some(4)
def test_every_rank_has_a_part(comm, parts):
    p = body(comm, cells=2)
    _, _, residual = solve(p, right_side(p), rtol=1e-6)
    assert comm.allreduce(residual, op=MPI.MAX) < 1e-5
