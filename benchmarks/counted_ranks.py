"""Solve a load step of the stretch and write what each rank did, for `benchmarks.scaling`.

mpirun -n 4 python -m benchmarks.counted_ranks FILE '{"cells": 28, "stretch": 1.4, "petsc": {}}'
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx, scenes, solver
from fem_snh._petsc import default_options
from fem_snh.linalg.coarse_matrix import CoarseMatrix
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.runs.setup import set_up

#: Calls that are timed together, and the bytes of a large message.
_CALLS, _LARGE = 200, 4_000_000


def main(file: Path, settings: dict[str, Any]) -> None:
    """Solve the scene's first load step and write the counts of all ranks. Collective."""
    comm = MPI.COMM_WORLD
    options = settings.pop("petsc")
    with default_options(solver.PREFIX, options):
        setup = set_up(comm, scenes.load("stretch", steps=1, nu=0.49, **settings))
    updates = _timed_updates()
    PETSc.Log.begin()
    comm.Barrier()
    before, start = _counts(), perf_counter()
    row = next(iter(setup.stepper))
    seconds, sent = perf_counter() - start, _counts() - before
    context = setup.snes.getKSP().getPythonContext()
    assert isinstance(context, EisenstatCG)
    system, deflation = context._system, context._system.deflation
    arrays = system.matrix.arrays
    own = {
        "cells": _dolfinx.num_owned(setup.problem.domain),
        "upper_blocks": len(arrays["upper_column"]),
        "shared_blocks": len(arrays["off_diagonal_column"]) if comm.size > 1 else 0,
        "coarse_pairs": len(deflation.arrays["pair_subdomain"]) if deflation else 0,
        "sent": sent.tolist(),
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "seconds": seconds,
        "ksp_seconds": PETSc.Log.Event("KSPSolve").getPerfInfo()["time"],
        "coarse_updates": sum(updates),
        "coarse_solve": 0.0,
    }
    subdomains = 0
    if deflation:
        y, subdomains = np.ones(len(deflation._y)), deflation.E._shape[0]
        own["coarse_solve"] = _best(comm, lambda: deflation.E.solve(y.copy()))
    ranks = comm.gather(own)
    network = _network(comm)
    if ranks is not None:
        kept = ("converged", "newton", "linear", "energy")
        record = {key: row[key] for key in kept} | {"dofs": setup.problem.dofs}
        record["subdomains"] = subdomains
        file.write_text(json.dumps(record | network | {"ranks": ranks}))


def _timed_updates() -> list[float]:
    """Return a list that gets the seconds of each update of a coarse matrix from now on."""
    seconds: list[float] = []
    update = CoarseMatrix.update

    def timed(self: CoarseMatrix, contributions: Any) -> int:
        start = perf_counter()
        try:
            return update(self, contributions)
        finally:
            seconds.append(perf_counter() - start)

    CoarseMatrix.update = timed  # type: ignore[method-assign]  # the method, timed
    return seconds


def _counts() -> np.ndarray:
    """Return messages, their bytes, collectives and their bytes of this rank so far."""
    library = ctypes.CDLL(os.environ["LD_PRELOAD"])
    library.mpi_counts.restype = ctypes.POINTER(ctypes.c_double)
    return np.array(library.mpi_counts()[:4])


def _best(comm: MPI.Intracomm, call: Callable[[], Any]) -> float:
    """Return the seconds of a call, the best of three series."""
    best = float("inf")
    for _ in range(3):
        comm.Barrier()
        start = perf_counter()
        for _ in range(_CALLS):
            call()
        best = min(best, (perf_counter() - start) / _CALLS)
    return comm.allreduce(best, op=MPI.MAX)


def _network(comm: MPI.Intracomm) -> dict[str, float]:
    """Return the seconds of an empty message, of a byte more, and of a sum over the ranks."""
    if comm.size == 1:
        return {"latency": 0.0, "seconds_per_byte": 0.0, "sum_seconds": 0.0}
    other = comm.rank ^ 1

    def exchange(buffer: np.ndarray) -> None:
        if comm.rank < 2:
            comm.Sendrecv_replace(buffer, other)

    number, many = np.zeros(1), np.zeros(_LARGE // 8)
    small = _best(comm, lambda: exchange(number))
    large = _best(comm, lambda: exchange(many))
    total = _best(comm, lambda: comm.Allreduce(MPI.IN_PLACE, number))
    return {
        "latency": small,
        "seconds_per_byte": max(large - small, 0.0) / _LARGE,
        "sum_seconds": total,
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]), json.loads(sys.argv[2]))
