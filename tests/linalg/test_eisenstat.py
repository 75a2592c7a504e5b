"""SSOR-preconditioned conjugate gradients in single precision, as a PETSc KSP."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from bodies import MINIMISING, Hold, cube, problem, set_values, wave

from fem_snh._petsc import default_options
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.linalg.ssor_cg import EisenstatCG

mpi = pytest.mark.mpi
Reason = PETSc.KSP.ConvergedReason


def body(comm, element="Q1", size=0.05, E=1.0, filter="clamp", cells=4, hold=("x", "y", "z")):
    """A cube under a wave of displacement, its left side constrained, with its matrix assembled."""
    left = [Hold("left", components=hold)] if hold else []
    p = problem(cube(comm, ELEMENTS[element].cell, cells, 0.03), element, hold=left, E=E)
    set_values(p, wave(size), p.x)
    p.prescribe(p.x)
    p.jacobian(p.x, filter)
    return p


def right_side(p):
    """The residual of the problem at its displacement."""
    b = p.x.duplicate()
    p.residual(p.x, b)
    return b


@pytest.fixture(autouse=True, params=[0, 5], ids=["plain", "deflated"])
def subdomains(request):
    """The number of deflation subdomains: none, or some."""
    with default_options("", {"ksp_deflation_subdomains": request.param}):
        yield request.param


def solver(p, rtol=1e-3, kind="ours"):
    """A KSP: EisenstatCG, or PETSc's CG with a preconditioner of this type."""
    ksp = PETSc.KSP().create(p.A.comm)
    ksp.setOperators(p.A)
    if kind == "ours":
        ksp.setType("python")
        ksp.setPythonContext(EisenstatCG(p.coordinates[:, : p.regime.dimension]))
        ksp.getPC().setType("none")
        ksp.setFromOptions()
    else:
        ksp.setType("cg")
        ksp.getPC().setType(kind)
        ksp.setNormType(PETSc.KSP.NormType.NATURAL)
        if kind == "sor":
            database = PETSc.Options("t_")
            database["pc_sor_local_symmetric"] = None
            ksp.setOptionsPrefix("t_")
            ksp.setFromOptions()
            database.delValue("pc_sor_local_symmetric")
    ksp.setTolerances(rtol=rtol, atol=0.0, max_it=2000)
    return ksp


def solve(p, b, **options):
    """The KSP, the solution and the true relative residual."""
    ksp, A = solver(p, **options), p.A
    x, r = b.duplicate(), b.duplicate()
    x.set(7.0)  # the initial guess is ignored
    ksp.solve(b, x)
    A.mult(x, r)
    r.axpy(-1.0, b)
    return ksp, x, r.norm() / b.norm()


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", MINIMISING)
@pytest.mark.parametrize("rtol", [1e-2, 1e-5, 1e-11])
def test_solves_to_any_tolerance(comm, element, rtol):
    p = body(comm, element)
    ksp, _, residual = solve(p, right_side(p), rtol=rtol)
    assert ksp.getConvergedReason() == Reason.CONVERGED_RTOL
    assert residual <= 10 * rtol


@pytest.mark.parametrize("rtol", [1e-2, 1e-6])
def test_iterations_are_those_of_petsc_with_ssor(comm, rtol):
    """The same method in double precision, by points there and by blocks here."""
    p = body(comm)
    b = right_side(p)
    ours, theirs = (solve(p, b, kind=kind, rtol=rtol)[0] for kind in ("ours", "sor"))
    cycles = 1 if rtol >= 1e-4 else 2  # a refinement cycle restarts the iteration
    assert ours.getIterationNumber() <= (1 + 0.1 * (cycles - 1)) * theirs.getIterationNumber() + 2
    jacobi, *_ = solve(p, b, kind="jacobi", rtol=rtol)
    assert ours.getIterationNumber() < 0.7 * jacobi.getIterationNumber()


@pytest.mark.one_debian("ranks")
@mpi
def test_changed_values_are_used(comm):
    p = body(comm)
    b = right_side(p)
    ksp, x, _ = solve(p, b, rtol=1e-8)
    p.A.scale(2.0)
    y = b.duplicate()
    ksp.solve(b, y)
    y.axpy(-0.5, x)
    assert y.norm() < 1e-7 * x.norm()


@pytest.mark.one_debian("ranks")
@mpi
def test_an_indefinite_matrix_is_detected(comm):
    p = body(comm, size=0.5, filter="exact")
    ksp, *_ = solve(p, right_side(p), rtol=1e-8)
    indefinite = (Reason.DIVERGED_INDEFINITE_MAT, Reason.DIVERGED_INDEFINITE_PC)
    assert ksp.getConvergedReason() in indefinite
    p.A.scale(-1.0)
    ksp, x, _ = solve(p, right_side(p))
    assert ksp.getConvergedReason() == Reason.DIVERGED_INDEFINITE_PC
    assert x.norm() == 0


@pytest.mark.one_debian("ranks")
@mpi
def test_a_node_without_stiffness(comm):
    """A zero row without force, as of a clamped Hessian where all cells of a node are crushed."""
    p = body(comm)
    b = right_side(p)
    first = p.A.getOwnershipRange()[0]
    rows = np.arange(first + 30, first + 33, dtype=PETSc.IntType)
    p.A.zeroRowsColumns(rows, diag=0.0)
    b.array[30:33] = 0.0
    ksp, x, residual = solve(p, b)
    assert ksp.getConvergedReason() > 0
    assert residual < 1e-2 and np.isfinite(x.array).all()


@mpi
def test_ranks_take_few_more_iterations_than_one_rank(comm):
    """At most 1.2 times; sweeps of each rank's rows alone take 1.27 times on two ranks."""
    taken = []
    for ranks in (MPI.COMM_SELF, comm):
        p = body(ranks, cells=12)
        ksp, x = solver(p, rtol=1e-4), p.x.duplicate()
        ksp.solve(right_side(p), x)
        assert ksp.getConvergedReason() > 0
        taken.append(ksp.getIterationNumber())
    alone, together = taken
    assert together <= 1.2 * alone
