"""Memory of large arrays after they are freed."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np

import fem_snh._petsc  # noqa: F401, loads PETSc

#: Bytes of an array: more than the 32 MiB from which glibc gives it pages of its own.
_SIZE = 2**26


def _resident() -> int:
    """Return the memory of this process [B]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def test_freed_arrays_leave_the_process() -> None:
    """SuperLU_DIST, which PETSc links, forbids it: temporaries would stay until the end."""
    before = _resident()
    arrays = [np.ones(_SIZE // 8) for _ in range(3)]
    grown = _resident() - before
    del arrays
    assert grown > 2.9 * _SIZE
    assert _resident() - before < 0.1 * _SIZE
