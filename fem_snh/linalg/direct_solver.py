"""Sparse direct solvers: MUMPS, insensitive to nu and to signs; PETSc's for small matrices.

Studies and benchmarks use MUMPS for reference solutions. A matrix that is not symmetric has factors
L U.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import expect_definite_matrix, is_cholesky

#: The PETSc options. MUMPS' "cholesky" is LDL^T, for symmetric indefinite matrices too.
DIRECT_SOLVER = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}
#: Unknowns of a matrix in two dimensions up to which PETSc's factors cost less than those by MUMPS
#: (python -m benchmarks small_factors; docs/results/linear_solver.md).
MAX_SMALL = 2000
#: Difference of x . A y and y . A x, relative to |x| |A y|, that is rounding: of sums it is 1e-14.
_ROUNDING = 1e-11


def set_direct_solver(ksp: PETSc.KSP, small: bool = False) -> None:
    """Configure an existing KSP as `DIRECT_SOLVER`.

    For a small matrix, on one rank, it has PETSc's factors while the matrix is definite.
    """
    ksp.setType(DIRECT_SOLVER["ksp_type"])
    set_direct_factors(ksp.getPC())
    if small:
        expect_definite_matrix(ksp)


def set_direct_factors(pc: PETSc.PC) -> None:
    """Configure an existing PC as `DIRECT_SOLVER`."""
    pc.setType(DIRECT_SOLVER["pc_type"])
    pc.setFactorSolverType(DIRECT_SOLVER["pc_factor_mat_solver_type"])


def is_direct(ksp: PETSc.KSP) -> bool:
    """Return whether a KSP is `DIRECT_SOLVER`, or for a small matrix."""
    packages = PETSc.Mat.SolverType.PETSC, PETSc.Mat.SolverType.MUMPS
    preonly = ksp.getType() == DIRECT_SOLVER["ksp_type"]
    return preonly and any(is_cholesky(ksp.getPC(), package) for package in packages)


def is_symmetric(A: PETSc.Mat) -> bool:
    """Return whether a square matrix is symmetric but for rounding. Collective.

    Two vectors without a symmetry tell: x . A y = y . A x for a symmetric matrix.
    """
    x, y = A.createVecs()
    first, last = x.getOwnershipRange()
    x.array[:], y.array[:] = np.sin(np.arange(first, last)), np.cos(1.7 * np.arange(first, last))
    Ax, Ay = x.duplicate(), x.duplicate()
    A.mult(x, Ax)
    A.mult(y, Ay)
    return bool(abs(x.dot(Ay) - y.dot(Ax)) <= _ROUNDING * x.norm() * Ay.norm())


def set_asymmetric_factors(ksp: PETSc.KSP) -> None:
    """Let a KSP solve by sparse factors L U, by MUMPS."""
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType(DIRECT_SOLVER["pc_factor_mat_solver_type"])
