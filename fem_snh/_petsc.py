"""Functions of PETSc's C interface that petsc4py lacks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh import cache
from fem_snh.arrays import ArrayLike
from fem_snh.errors import BadInput

ffi = cache.c_declarations("""
int MatMPIAIJGetSeqAIJ(void *A, void **diagonal, void **off_diagonal, int **ghosts);
int MatSeqAIJGetArray(void *A, double **values);
int MatSeqAIJRestoreArray(void *A, double **values);
int MatSeqAIJGetArrayRead(void *A, double **values);
int MatSeqAIJRestoreArrayRead(void *A, double **values);
int MatGetSize(void *A, int *rows, int *columns);
int MatGetNonzeroState(void *A, long *state);
int MatGetRowIJ(void *A, int shift, int symmetric, int compressed, int *n, int **indptr,
                int **indices, int *done);
int MatLMVMAllocate(void *B, void *x, void *f);
int MatLMVMReset(void *B, int destructive);
int MatLMVMUpdate(void *B, void *x, void *f);
int MatLMVMSetJ0PC(void *B, void *pc);
int KSPCGSetRadius(void *ksp, double radius);
int KSPCGGetNormD(void *ksp, double *norm);
int PCGetFailedReason(void *pc, int *reason);
int PetscOptionsUsed(void *options, const char *name, int *used);
int mallopt(int option, int value);
""")
_reasons = PETSc.KSP.ConvergedReason
#: Converged reason of Steihaug's CG at negative curvature (its name depends on the version).
NEGATIVE_CURVATURE = (
    _reasons.CONVERGED_NEG_CURVE
    if hasattr(_reasons, "CONVERGED_NEG_CURVE")
    else _reasons.CONVERGED_CG_NEG_CURVE
)


@lru_cache
def _library() -> Any:
    """Return PETSc's shared library; raise BadInput if its integers have 64 bits."""
    bits = 8 * np.dtype(PETSc.IntType).itemsize
    if bits != 32:
        raise BadInput(
            f"PetscInt = {bits} bits: expected 32 (PETSc configured without 64-bit indices)"
        )
    # A symbol looked up in the extension module is also found in the PETSc that it links.
    return ffi.dlopen(PETSc.__file__)


def call(name: str, *arguments: Any) -> None:
    """Call a PETSc function; petsc4py objects are passed by their handles.

    Raises
    ------
    PETSc.Error
        If the function fails.
    BadInput
        If PETSc is configured with 64-bit integers.
    """
    given = (ffi.cast("void *", a.handle) if isinstance(a, PETSc.Object) else a for a in arguments)
    if code := getattr(_library(), name)(*given):
        raise PETSc.Error(code)


# SuperLU_DIST, which PETSc links, lets glibc never return freed memory: temporary arrays of the
# set-up of a large problem would stay in the process. M_MMAP_THRESHOLD (the size [B] from which an
# array has pages of its own) and M_TRIM_THRESHOLD are the largest that glibc adapts them to, and
# M_MMAP_MAX its default (malloc/malloc.c).
if mallopt := getattr(ffi.dlopen(None), "mallopt", None):
    for option_and_value in ((-3, 2**25), (-4, 2**16), (-1, 2**26)):
        mallopt(*option_and_value)
#: Preconditioners, among them ours, for which a matrix of type "python" will do.
_WITHOUT_ENTRIES = (PETSc.PC.Type.PYTHON, PETSc.PC.Type.NONE, PETSc.PC.Type.JACOBI)
#: Attribute of a matrix: how often `set_pattern` was called.
_PATTERNS = "fem_snh_patterns"
#: Attribute of a KSP: the handle and `nonzero_state` of its last matrix P.
_SEEN = "fem_snh_seen_pattern"
#: Attribute of a KSP: set by `expect_singular_matrix`.
_SINGULAR = "fem_snh_singular"
#: Attribute of a KSP: set by `expect_definite_matrix`.
_DEFINITE = "fem_snh_definite"


def vector_like(x: PETSc.Vec, values: ArrayLike = ()) -> PETSc.Vec:
    """Return a new vector of the layout of ``x``: on each rank ``values`` (n,), then zeros."""
    vector, first = x.duplicate(), np.asarray(values)
    vector.set(0.0)
    vector.array[: len(first)] = first
    return vector


def jacobi_cg(comm: Any, **tolerances: float) -> PETSc.KSP:
    """Return PETSc's conjugate gradients with Jacobi's preconditioner, without a prefix."""
    ksp = PETSc.KSP().create(comm)
    ksp.setType(PETSc.KSP.Type.CG)
    ksp.getPC().setType(PETSc.PC.Type.JACOBI)
    ksp.setTolerances(**tolerances)
    return ksp


def nonzero_state(A: PETSc.Mat) -> tuple[int, int]:
    """Return two numbers, at least one of which changes with the matrix's sparsity pattern."""
    state = ffi.new("long *")  # PetscObjectState, of 64 bits
    call("MatGetNonzeroState", A, state)
    return int(state[0]), int(A.getAttr(_PATTERNS) or 0)


def set_pattern(A: PETSc.Mat, csr: tuple[Any, ...]) -> None:
    """Give a matrix another CSR pattern, (indptr, indices), and zero values. Collective.

    PETSc's nonzero state may stay the same: since 3.22 a parallel matrix's state is the sum of its
    new blocks' states. So an attribute counts the patterns (`nonzero_state`).
    """
    A.setPreallocationCSR(csr)
    A.setAttr(_PATTERNS, int(A.getAttr(_PATTERNS) or 0) + 1)


def as_aij(A: PETSc.Mat) -> PETSc.Mat:
    """Return A, or the AIJ copy of a `fem_snh.linalg.half_matrix.HalfMatrix`. Collective."""
    return A.getPythonContext().aij(A) if A.getType() == PETSc.Mat.Type.PYTHON else A


def set_operators(ksp: PETSc.KSP, A: PETSc.Mat, P: PETSc.Mat) -> None:
    """Set a solver's operator A and the matrix P of its preconditioner. Collective.

    If P or its pattern has changed, the preconditioner is set up from the start: PETSc compares
    nonzero states only. Factors by MUMPS, and PETSc's after `expect_definite_matrix`, are computed
    here. MUMPS replaces PETSc's factors that are not positive definite, gets a larger workspace if
    it needs one, and counts negative pivots on several ranks.
    """
    if ksp.getPC().getType() not in _WITHOUT_ENTRIES:
        A, P = as_aij(A) if A == P else A, as_aij(P)
    pattern = P.handle, nonzero_state(P)
    if (former := ksp.getAttr(_SEEN)) is not None and former != pattern:
        other = PETSc.Mat().createPython(P.getSizes(), comm=P.comm)
        ksp.setOperators(other, other)
        other.destroy()
    ksp.setAttr(_SEEN, pattern)
    ksp.setOperators(A, P)
    pc = ksp.getPC()
    if ksp.getAttr(_DEFINITE) and is_cholesky(pc, PETSc.Mat.SolverType.PETSC):
        ksp.setUp()
        if not _is_positive_definite(pc):
            pc.reset()
            pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
            ksp.setOperators(A, P)
    if _has_mumps_factors(pc):
        _factorise(ksp)
        while workspace := _larger_workspace(pc.getFactorMatrix()):
            pc.reset()  # otherwise PETSc does not try again after MUMPS failed
            ksp.setOperators(A, P)
            _factorise(ksp, workspace)


def _factorise(ksp: PETSc.KSP, workspace: int | None = None) -> None:
    """Factorise by MUMPS with a workspace, ICNTL(14); None: the default. Collective."""
    ksp.getPC().setFactorSetUpSolverType()  # controls must be set before the analysis
    factors = ksp.getPC().getFactorMatrix()
    factors.setMumpsIcntl(_ROOT_ON_ONE_RANK, 1)
    if ksp.getAttr(_SINGULAR):
        factors.setMumpsIcntl(_NULL_PIVOTS, 1)
    if workspace is not None:
        factors.setMumpsIcntl(_WORKSPACE, workspace)
    ksp.setUp()


def _larger_workspace(factors: PETSc.Mat) -> int:
    """Return twice the workspace [%] if MUMPS lacked workspace for pivoting; else 0.

    Return 0 also above `_MOST_WORKSPACE`, and if the user has limited MUMPS' memory.
    """
    lacks = factors.getMumpsInfog(1) in _LACKS_WORKSPACE
    larger = 2 * max(factors.getMumpsIcntl(_WORKSPACE), 1)
    return (
        larger if lacks and larger <= _MOST_WORKSPACE and not factors.getMumpsIcntl(_LIMIT) else 0
    )


def expect_singular_matrix(ksp: PETSc.KSP) -> None:
    """Let MUMPS accept null pivots: consistent systems are solved with those unknowns zero."""
    ksp.setAttr(_SINGULAR, True)


def expect_definite_matrix(ksp: PETSc.KSP) -> None:
    """Let PETSc factorise, without pivoting, until a matrix is not positive definite.

    From then on MUMPS factorises (`set_operators`).
    """
    ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.PETSC)
    ksp.getPC().setFactorPivot(0.0)  # whatever the units, only 0 counts as a zero pivot
    ksp.setAttr(_DEFINITE, True)


#: PETSC_ERR_MEM, the error code of an allocation that failed.
OUT_OF_MEMORY = 55
_FACTORS_OUT_OF_MEMORY = 3  # PC_FACTOR_OUTMEMORY of PCFailedReason
#: INFOG(1) of MUMPS for every lack of memory, its own limit included (MUMPS user guide, sec. 8).
_MUMPS_OUT_OF_MEMORY = (-7, -8, -9, -11, -13, -14, -15, -17, -19, -20)

#: INFOG(1) where pivoting needs more workspace; ICNTL(14), the workspace [%] beyond the estimate of
#: the analysis, and its largest value here; ICNTL(23), the user's limit of memory.
_LACKS_WORKSPACE, _WORKSPACE, _MOST_WORKSPACE, _LIMIT = (-8, -9), 14, 1000, 23


def factors_out_of_memory(pc: PETSc.PC) -> bool:
    """Return whether the last set-up of a PC failed because its factors exceed the memory."""
    reason = _failed_reason(pc)
    if reason and _has_mumps_factors(pc):
        return mumps_out_of_memory(pc)
    return bool(reason == _FACTORS_OUT_OF_MEMORY)


def _failed_reason(pc: PETSc.PC) -> int:
    """Return PETSc's PCFailedReason of the last set-up of a PC; 0: it did not fail."""
    found = ffi.new("int *")
    call("PCGetFailedReason", pc, found)
    return int(found[0])


def mumps_out_of_memory(pc: PETSc.PC) -> bool:
    """Return whether MUMPS ran out of memory, also where PETSc reports no failed reason."""
    return pc.getFactorMatrix().getMumpsInfog(1) in _MUMPS_OUT_OF_MEMORY


#: ICNTL(13) of MUMPS: 1 keeps the root of the elimination tree on one rank, as ScaLAPACK, which
#: shares it, counts no negative pivots (MUMPS user guide, sec. 5.3 and 8).
_ROOT_ON_ONE_RANK = 13
#: ICNTL(24) of MUMPS: null pivots are detected.
_NULL_PIVOTS = 24


def is_cholesky(pc: PETSc.PC, package: str) -> bool:
    """Return whether a PC has Cholesky factors by ``package``, a PETSc.Mat.SolverType."""
    return bool(pc.getType() == PETSc.PC.Type.CHOLESKY and pc.getFactorSolverType() == package)


def _has_mumps_factors(pc: PETSc.PC) -> bool:
    """Return whether a PC has Cholesky or LU factors by MUMPS."""
    factors = pc.getType() in (PETSc.PC.Type.CHOLESKY, PETSc.PC.Type.LU)
    return bool(factors and pc.getFactorSolverType() == PETSc.Mat.SolverType.MUMPS)


def _is_positive_definite(pc: PETSc.PC) -> bool:
    """Return whether PETSc's factors of a PC have positive pivots only.

    L L^T without pivoting is then numerically stable (Higham 2002, theorem 10.3).
    """
    return not _failed_reason(pc) and pc.getFactorMatrix().getInertia()[:2] == (0, 0)


def negative_pivots(pc: PETSc.PC) -> int | None:
    """Return the number of negative pivots of a PC's factors L D L^T; None if it is unknown.

    MUMPS is asked directly, as MatGetInertia requires the detection of null pivots.
    """
    if is_cholesky(pc, PETSc.Mat.SolverType.PETSC):
        return 0 if _is_positive_definite(pc) else None  # without pivoting, signs may be wrong
    if not is_cholesky(pc, PETSc.Mat.SolverType.MUMPS):
        return None
    factors = pc.getFactorMatrix()
    if factors.getMumpsInfog(1) < 0:
        return None
    if pc.comm.size > 1 and factors.getMumpsIcntl(_ROOT_ON_ONE_RANK) != 1:
        return None
    return int(factors.getMumpsInfog(12))


def option_used(name: str) -> bool:
    """Return whether anything has queried PETSc's option ``name`` (without the dash)."""
    used = ffi.new("int *")
    call("PetscOptionsUsed", ffi.NULL, name.encode(), used)
    return bool(used[0])


@contextmanager
def default_options(prefix: str, options: Mapping[str, Any]) -> Iterator[list[str]]:
    """Set those PETSc options that the user has not set, for the duration of a ``with`` block.

    Parameters
    ----------
    prefix : str
        The options prefix.
    options : mapping
        Values by option name without the prefix; None for a flag.

    Yields
    ------
    list of str
        The names of the options that were set.
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
    """A sequential AIJ matrix: the diagonal or the off-diagonal block of one rank's rows.

    Attributes
    ----------
    handle : cffi pointer
        The ``Mat``.
    values : int
        Address of the value array.
    ghosts : (columns,) int32
        Global columns of the off-diagonal block, ascending; empty for the diagonal block.
    """

    handle: Any
    values: int
    ghosts: np.ndarray

    def csr(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (indptr, indices), views of PETSc's arrays."""
        n, done = ffi.new("int *"), ffi.new("int *")
        pattern = ffi.new("int *[2]")
        call("MatGetRowIJ", self.handle, 0, 0, 0, n, pattern, pattern + 1, done)
        indptr = np.frombuffer(ffi.buffer(pattern[0], 4 * (n[0] + 1)), np.int32)
        return indptr, np.frombuffer(ffi.buffer(pattern[1], 4 * int(indptr[-1])), np.int32)

    def array(self) -> np.ndarray:
        """Return a writable view of the values, (nonzeros,) float64."""
        return values_at(self.values, int(self.csr()[0][-1]))


def values_at(address: int, size: int) -> np.ndarray:
    """Return a view of ``size`` float64 values at an address."""
    return np.frombuffer(ffi.buffer(ffi.cast("double *", address), 8 * size))


@contextmanager
def aij_blocks(A: PETSc.Mat, read_only: bool = False) -> Iterator[list[AIJBlock]]:
    """Access the value arrays of an AIJ matrix for the duration of a ``with`` block.

    Parameters
    ----------
    A : Mat
    read_only : bool
        If False, the state of each block is increased. The state of a parallel matrix is not: its
        solvers set up again only after ``A.stateIncrease()``.

    Yields
    ------
    list of AIJBlock
        The diagonal block and, on several ranks, the off-diagonal block.
    """
    handle, blocks = ffi.cast("void *", A.handle), ffi.new("void *[2]")
    ghosts: list[np.ndarray] = [np.empty(0, np.int32)] * 2
    if A.getType() == PETSc.Mat.Type.SEQAIJ:
        blocks[0] = handle
    else:
        columns, count = ffi.new("int **"), ffi.new("int *")
        call("MatMPIAIJGetSeqAIJ", handle, blocks, blocks + 1, columns)
        call("MatGetSize", blocks[1], ffi.NULL, count)
        ghosts[1] = np.frombuffer(ffi.buffer(columns[0], 4 * count[0]), np.int32).copy()
    arrays = ffi.new("double *[2]")
    present = [k for k in range(2) if blocks[k] != ffi.NULL]
    access = "ArrayRead" if read_only else "Array"
    for k in present:
        call(f"MatSeqAIJGet{access}", blocks[k], arrays + k)
    try:
        yield [
            AIJBlock(blocks[k], int(ffi.cast("intptr_t", arrays[k])), ghosts[k]) for k in present
        ]
    finally:
        for k in present:
            call(f"MatSeqAIJRestore{access}", blocks[k], arrays + k)
