"""The few functions of PETSc's C interface that petsc4py does not have."""

from __future__ import annotations

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
int PetscOptionsUsed(void *options, const char *name, int *used);
""")
# The extension module's own file: looking a symbol up in it also finds those of its PETSc.
_library = ffi.dlopen(PETSc.__file__)


def call(name: str, *arguments: Any) -> None:
    """Call a PETSc function. Raises PETSc.Error if it fails."""
    if code := getattr(_library, name)(*arguments):
        raise PETSc.Error(code)


def option_used(name: str) -> bool:
    """Whether anything has asked PETSc's database for the option ``name`` (without the dash)."""
    used = ffi.new("int *")
    call("PetscOptionsUsed", ffi.NULL, name.encode(), used)
    return bool(used[0])
