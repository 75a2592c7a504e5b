"""Import ipctk, after a test in another process that it runs on this processor.

This module does not import PETSc, which would catch the signal of an instruction that the processor
does not have, and replace it by an exit code.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.processes import call


def import_ipctk() -> Any:
    """Return the module ipctk, and set it to use one thread.

    Raises
    ------
    BadInput
        If ipctk is not installed, or crashes: some of its wheels need instructions that not every
        processor has.
    """
    try:
        import ipctk
    except ImportError:
        raise BadInput(
            "self_contact.method = 'ipc' needs the package ipctk: pip install 'fem_snh[contact]'"
        ) from None
    if crash := _crash():
        raise BadInput(
            f"self_contact.method = 'ipc': {crash} on one triangle: expected a processor for which "
            "the package is compiled, or method = 'reference'"
        )
    # One thread adds in one order: all ranks get the same bits, and MPI uses the other cores.
    ipctk.set_num_threads(1)
    return ipctk


@cache
def _crash() -> str:
    """Return how ipctk crashes on this processor, for a message; "" if it works. Cached."""
    try:
        call("ipctk", enclose_one_triangle)
    except BadInput as error:
        return str(error).partition(":")[0]
    return ""


def enclose_one_triangle() -> int:
    """Return the number of points, 3, of ipctk's mesh of one triangle; may crash the process."""
    import ipctk

    points, triangle = np.asfortranarray(np.eye(3)), np.asfortranarray([[0, 1, 2]], dtype=np.int32)
    return int(ipctk.CollisionMesh(points, ipctk.edges(triangle), triangle).num_vertices)
