"""PETSc options of a sparse direct solver (MUMPS): insensitive to nu, cheap on slender bodies.

Studies and benchmarks use it for reference solutions.
"""

from __future__ import annotations

from petsc4py import PETSc

#: The PETSc options. MUMPS' "cholesky" is LDL^T, for symmetric indefinite matrices too.
DIRECT_SOLVER = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}


def set_direct_solver(ksp: PETSc.KSP) -> None:
    """Configure an existing KSP as `DIRECT_SOLVER`."""
    ksp.setType(DIRECT_SOLVER["ksp_type"])
    set_direct_factors(ksp.getPC())


def set_direct_factors(pc: PETSc.PC) -> None:
    """Configure an existing PC as `DIRECT_SOLVER`."""
    pc.setType(DIRECT_SOLVER["pc_type"])
    pc.setFactorSolverType(DIRECT_SOLVER["pc_factor_mat_solver_type"])


def is_direct(ksp: PETSc.KSP) -> bool:
    """Return whether a KSP is `DIRECT_SOLVER`."""
    pc = ksp.getPC()
    return (
        ksp.getType() == DIRECT_SOLVER["ksp_type"]
        and pc.getType() == DIRECT_SOLVER["pc_type"]
        and pc.getFactorSolverType() == DIRECT_SOLVER["pc_factor_mat_solver_type"]
    )
