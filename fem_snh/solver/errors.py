"""Exceptions that are raised in PETSc or pass through it, and the clean-up of PETSc objects.

petsc4py does not destroy an object when Python drops it, as ranks may drop objects in different
orders: the object is kept until ``PETSc.garbage_cleanup`` is called for its communicator. Every
mesh and matrix of dolfinx has a communicator of its own, which a program cannot ask for once the
problem is dropped. So `record_solver` records the communicators when a solver is created.

``PetscGarbageCleanup`` takes the list of dropped objects from the communicator, destroys the
objects, and puts the list back. An object that Python drops in between, as a SNES that refers to
it is destroyed, is put on another list, which is overwritten: the object is never destroyed. So
`free_unused` keeps the objects to which a SNES refers until the SNES is destroyed, and the contexts
of linear solvers and matrices until these are destroyed.
"""

from __future__ import annotations

import gc
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import NamedTuple
from weakref import ref

from mpi4py import MPI
from petsc4py import PETSc

from fem_snh._petsc import OUT_OF_MEMORY
from fem_snh.errors import Failed


@contextmanager
def without_collection() -> Iterator[None]:
    """Disable Python's garbage collector within a ``with`` block."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


@contextmanager
def callback_errors() -> Iterator[None]:
    """Let the exceptions of Python callbacks (`BadInput`, Ctrl-C) pass through PETSc unchanged.

    Newer versions of petsc4py raise a PETSc.Error whose cause is the callback's exception. The
    garbage collector is disabled meanwhile: in Python 3.13 it drops an exception that is on its way
    through PETSc, and petsc4py then ends with a segmentation fault.
    """
    try:
        with without_collection():
            yield
    except PETSc.Error as error:
        _raise_callback_error(error)
        raise


def _raise_callback_error(error: PETSc.Error) -> None:
    """Raise the exception of a Python callback that caused a PETSc.Error; return without one."""
    cause: BaseException = error
    while isinstance(cause, PETSc.Error) and cause.__cause__ is not None:
        cause = cause.__cause__
    if not isinstance(cause, PETSc.Error):
        raise cause from None


def cause_of(error: Exception) -> str:
    """Return the cause of an error in one line: for a PETSc.Error, the last line of its stack."""
    last = (str(error).strip().splitlines() or [""])[-1].partition("] ")[2]
    return last or " ".join(str(error).split())


@contextmanager
def petsc_failures() -> Iterator[None]:
    """Raise PETSc's errors and exhausted memory as `Failed`, with a message of one line.

    The exceptions of callbacks are raised as they are, as by `callback_errors`.
    """
    try:
        yield
    except MemoryError as error:
        raise Failed(f"out of memory ({str(error) or 'an array'})") from error
    except PETSc.Error as error:
        _raise_callback_error(error)
        if error.ierr == OUT_OF_MEMORY:
            raise Failed("out of memory (PETSc)") from error
        raise Failed(f"PETSc error {error.ierr}: {cause_of(error)}") from error


class _Record(NamedTuple):
    """Weak references to a problem and the contexts of its solvers, and communicators."""

    problem: ref[object]
    newton: ref[object]
    linear: list[ref[object]]
    comms: list[PETSc.Comm]


_records: list[_Record] = []


def record_solver(problem: object, snes: PETSc.SNES, *objects: PETSc.Object) -> None:
    """Record the communicators of ``objects`` and ``snes`` for `free_unused`. Collective."""
    newton = snes.getPythonContext()
    solvers = [snes.getKSP(), *([newton.trust_ksp] if newton.trust_ksp is not None else [])]
    parts = [part for ksp in solvers for part in (ksp, ksp.getPC())]
    python = [part for part in (*parts, *objects) if part.getType() == "python"]
    # A duplicate is PETSc's own communicator with one more reference: it outlives the problem.
    comms = [item.comm.duplicate() for item in (*objects, snes)]
    linear = [ref(part.getPythonContext()) for part in python]
    _records.append(_Record(ref(problem), ref(newton), linear, comms))


def free_unused(comm: MPI.Comm) -> None:
    """Destroy the PETSc objects to which no rank of ``comm`` refers any longer. Collective.

    Objects on other groups of ranks are left for calls with a communicator of these ranks.
    """
    clean([PETSc.COMM_SELF])  # each rank's own, as the factors of a coarse matrix
    for entry in [r for r in _records if _same_ranks(r.comms[0].tompi4py(), comm)]:
        users: list[object] = [entry.problem(), entry.newton()]
        contexts = [reference() for reference in entry.linear]
        clean(entry.comms)  # a SNES, which refers to its problem
        users.clear()
        unused = comm.allreduce(entry.problem() is None, op=MPI.LAND)
        clean(entry.comms)  # the objects of the problem, and linear solvers
        contexts.clear()
        clean(entry.comms)  # the objects of linear solvers' contexts
        if unused:
            for each in entry.comms:
                each.destroy()
            _records.remove(entry)


def clean(comms: Iterable[PETSc.Comm]) -> None:
    """Destroy the objects of these communicators that all ranks have dropped. Collective."""
    with without_collection():  # Python must drop nothing meanwhile
        for comm in comms:
            PETSc.garbage_cleanup(comm)


def _same_ranks(first: MPI.Comm, second: MPI.Comm) -> bool:
    """Return whether two communicators have the same ranks, in the same order."""
    return MPI.Comm.Compare(first, second) in (MPI.IDENT, MPI.CONGRUENT)
