"""The few functions of PETSc's C interface that petsc4py does not have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

import cffi

ffi = cffi.FFI()
ffi.cdef("""
int MatMPIAIJGetSeqAIJ(void *A, void **diagonal, void **off_diagonal, const int **columns);
int MatSeqAIJGetArray(void *A, double **values);
int MatSeqAIJRestoreArray(void *A, double **values);
int MatSetValues(void *A, int m, const int *rows, int n, const int *columns,
                 const double *values, int mode);
int KSPCGSetRadius(void *ksp, double radius);
int KSPCGGetNormD(void *ksp, double *norm);
int PCGetFailedReason(void *pc, int *reason);
int PetscOptionsUsed(void *options, const char *name, int *used);
""")
_reasons = PETSc.KSP.ConvergedReason
#: How Steihaug's conjugate gradients say that they met negative curvature (names of 3.18, 3.22).
NEGATIVE_CURVATURE = (
    _reasons.CONVERGED_NEG_CURVE
    if hasattr(_reasons, "CONVERGED_NEG_CURVE")
    else _reasons.CONVERGED_CG_NEG_CURVE
)
# The extension module's own file: looking a symbol up in it also finds those of its PETSc.
_library = ffi.dlopen(PETSc.__file__)


def call(name: str, *arguments: Any) -> None:
    """Call a PETSc function. Raises PETSc.Error if it fails."""
    if code := getattr(_library, name)(*arguments):
        raise PETSc.Error(code)


#: PETSc's error code of an allocation that failed.
OUT_OF_MEMORY = 55
_FACTORS_OUT_OF_MEMORY = 3  # of PCFailedReason
#: What MUMPS says of memory in INFOG(1). Of some PETSc knows, not of its own limit too small.
_MUMPS_OUT_OF_MEMORY = (-7, -8, -9, -11, -13, -14, -15, -17, -19, -20)


def factors_out_of_memory(pc: PETSc.PC) -> bool:
    """Whether the last set-up failed as the factors took too much memory."""
    found = ffi.new("int *")
    call("PCGetFailedReason", ffi.cast("void *", pc.handle), found)
    if found[0] and pc.getType() in (PETSc.PC.Type.LU, PETSc.PC.Type.CHOLESKY):
        if pc.getFactorSolverType() == PETSc.Mat.SolverType.MUMPS:
            return pc.getFactorMatrix().getMumpsInfog(1) in _MUMPS_OUT_OF_MEMORY
    return bool(found[0] == _FACTORS_OUT_OF_MEMORY)


def option_used(name: str) -> bool:
    """Whether anything has asked PETSc's database for the option ``name`` (without the dash)."""
    used = ffi.new("int *")
    call("PetscOptionsUsed", ffi.NULL, name.encode(), used)
    return bool(used[0])


@contextmanager
def defaults(prefix: str, options: Mapping[str, Any]) -> Iterator[list[str]]:
    """Meanwhile these are options under a prefix, where nothing else was given. Lends their names.

    A flag has the value None.
    """
    database = PETSc.Options(prefix)
    ours = {name: value for name, value in options.items() if not database.hasName(name)}
    for name, value in ours.items():
        database[name] = value
    try:
        yield list(ours)
    finally:
        for name in ours:
            database.delValue(name)
