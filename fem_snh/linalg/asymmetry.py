"""Matrices that are not symmetric, and their factors."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from fem_snh.linalg.direct_solver import DIRECT_SOLVER

#: Difference of x . A y and y . A x, relative to |x| |A y|, that is rounding: of sums it is 1e-14.
_ROUNDING = 1e-11


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
