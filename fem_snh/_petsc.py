"""The few functions of PETSc's C interface that petsc4py does not have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import cffi
import numpy as np

ffi = cffi.FFI()
ffi.cdef("""
int MatMPIAIJGetSeqAIJ(void *A, void **diagonal, void **off_diagonal, int **ghosts);
int MatSeqAIJGetArray(void *A, double **values);
int MatSeqAIJRestoreArray(void *A, double **values);
int MatGetSize(void *A, int *rows, int *columns);
int MatGetRowIJ(void *A, int shift, int symmetric, int compressed, int *n, int **indptr,
                int **indices, int *done);
int MatSetValues(void *A, int m, const int *rows, int n, const int *columns,
                 const double *values, int mode);
int MatLMVMAllocate(void *B, void *x, void *f);
int MatLMVMReset(void *B, int destructive);
int MatLMVMUpdate(void *B, void *x, void *f);
int MatLMVMSetJ0PC(void *B, void *pc);
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
    """Call a PETSc function, with petsc4py's objects as they are. PETSc.Error if it fails."""
    given = (ffi.cast("void *", a.handle) if isinstance(a, PETSc.Object) else a for a in arguments)
    if code := getattr(_library, name)(*given):
        raise PETSc.Error(code)


#: PETSc's error code of an allocation that failed.
OUT_OF_MEMORY = 55
_FACTORS_OUT_OF_MEMORY = 3  # of PCFailedReason
#: What MUMPS says of memory in INFOG(1). Of some PETSc knows, not of its own limit too small.
_MUMPS_OUT_OF_MEMORY = (-7, -8, -9, -11, -13, -14, -15, -17, -19, -20)


def factors_out_of_memory(pc: PETSc.PC) -> bool:
    """Whether the last set-up failed as the factors took too much memory."""
    found = ffi.new("int *")
    call("PCGetFailedReason", pc, found)
    if found[0] and pc.getType() in (PETSc.PC.Type.LU, PETSc.PC.Type.CHOLESKY):
        if pc.getFactorSolverType() == PETSc.Mat.SolverType.MUMPS:
            return mumps_out_of_memory(pc)
    return bool(found[0] == _FACTORS_OUT_OF_MEMORY)


def mumps_out_of_memory(pc: PETSc.PC) -> bool:
    """Whether MUMPS' factors took too much memory; also after an error, which leaves no reason."""
    return pc.getFactorMatrix().getMumpsInfog(1) in _MUMPS_OUT_OF_MEMORY


def option_used(name: str) -> bool:
    """Whether anything has asked PETSc's database for the option ``name`` (without the dash)."""
    used = ffi.new("int *")
    call("PetscOptionsUsed", ffi.NULL, name.encode(), used)
    return bool(used[0])


@contextmanager
def default_options(prefix: str, options: Mapping[str, Any]) -> Iterator[list[str]]:
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


@dataclass
class AIJBlock:
    """A sequential AIJ matrix: its handle, the address of its values.

    Of other ranks' columns also ``ghosts``, their global numbers in ascending order; the matrix has
    them as 0, 1, ...
    """

    handle: Any
    values: int
    ghosts: np.ndarray

    def blocks(self, size: int) -> tuple[np.ndarray, np.ndarray]:
        """(indptr, indices) of its blocks of ``size`` unknowns; every block is whole."""
        n, done = ffi.new("int *"), ffi.new("int *")
        pattern = ffi.new("int *[2]")
        call("MatGetRowIJ", self.handle, 0, 0, 0, n, pattern, pattern + 1, done)
        indptr = np.frombuffer(ffi.buffer(pattern[0], 4 * (n[0] + 1)), np.int32)
        indices = np.frombuffer(ffi.buffer(pattern[1], 4 * int(indptr[-1])), np.int32)
        lengths = np.diff(indptr)[::size] // size
        starts = np.concatenate([[0], np.cumsum(lengths)])
        inside = np.arange(starts[-1]) - np.repeat(starts[:-1], lengths)
        return starts, indices[np.repeat(indptr[:-1:size], lengths) + size * inside] // size


@contextmanager
def aij_blocks(A: PETSc.Mat) -> Iterator[list[AIJBlock]]:
    """An AIJ matrix: its own columns and, where there are other ranks, theirs; to be written to."""
    handle, parts = ffi.cast("void *", A.handle), ffi.new("void *[2]")
    ghosts: list[np.ndarray] = [np.empty(0, np.int32)] * 2
    if A.getType() == PETSc.Mat.Type.SEQAIJ:
        parts[0] = handle
    else:
        columns, count = ffi.new("int **"), ffi.new("int *")
        call("MatMPIAIJGetSeqAIJ", handle, parts, parts + 1, columns)
        call("MatGetSize", parts[1], ffi.NULL, count)
        ghosts[1] = np.frombuffer(ffi.buffer(columns[0], 4 * count[0]), np.int32).copy()
    arrays = ffi.new("double *[2]")
    present = [k for k in range(2) if parts[k] != ffi.NULL]
    for k in present:
        call("MatSeqAIJGetArray", parts[k], arrays + k)
    try:
        yield [AIJBlock(parts[k], int(ffi.cast("intptr_t", arrays[k])), ghosts[k]) for k in present]
    finally:
        for k in present:
            call("MatSeqAIJRestoreArray", parts[k], arrays + k)
