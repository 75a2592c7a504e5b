"""Sparse factors instead of an iteration: blind to nu, and cheap on small or thin bodies."""

from __future__ import annotations

from typing import Any

#: As PETSc options: of a symmetric matrix, definite or not.
DIRECT_SOLVER = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}


def set_direct_solver(ksp: Any) -> None:
    """Have a PETSc KSP that is there already solve so."""
    ksp.setType(DIRECT_SOLVER["ksp_type"])
    ksp.getPC().setType(DIRECT_SOLVER["pc_type"])
    ksp.getPC().setFactorSolverType(DIRECT_SOLVER["pc_factor_mat_solver_type"])
