"""Exceptions that pass through PETSc, and PETSc's own."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

from fem_snh._petsc import OUT_OF_MEMORY
from fem_snh.errors import Failed


@contextmanager
def without_collection() -> Iterator[None]:
    """Leave cyclic garbage where it is within a ``with`` block."""
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

    Newer versions of petsc4py raise a PETSc.Error from them. No garbage is collected meanwhile: in
    Python 3.13 the collector drops an exception that is on its way through PETSc, and petsc4py then
    ends with a segmentation fault.
    """
    try:
        with without_collection():
            yield
    except PETSc.Error as error:
        _raise_callback_error(error)
        raise


def _raise_callback_error(error: PETSc.Error) -> None:
    """Raise the exception of the Python callback that a PETSc.Error comes from, if there is one."""
    cause: BaseException = error
    while isinstance(cause, PETSc.Error) and cause.__cause__ is not None:
        cause = cause.__cause__
    if not isinstance(cause, PETSc.Error):
        raise cause from None


def cause_of(error: Exception) -> str:
    """Return the cause of an error as one line: of PETSc's, the last line of its stack."""
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
