"""Sparse factors instead of an iteration: blind to nu, and cheap on small or thin bodies."""

from __future__ import annotations

from typing import Any

#: As PETSc options: of a symmetric matrix, definite or not.
DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}


def factorise(ksp: Any) -> None:
    """Have a PETSc KSP that is there already solve so."""
    ksp.setType(DIRECT["ksp_type"])
    ksp.getPC().setType(DIRECT["pc_type"])
    ksp.getPC().setFactorSolverType(DIRECT["pc_factor_mat_solver_type"])
