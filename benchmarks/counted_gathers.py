"""Run a scene and write what its ranks sent and gathered, for `benchmarks.gathers`.

mpirun -n 4 python -m benchmarks.counted_gathers FILE stretch '{"cells": 8, "error": true}'
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

from mpi4py import MPI

import numpy as np

import fem_snh

#: Calls of mpi4py after which ranks hold data of others.
_GATHERING = {"allgather", "Allgather", "Allgatherv", "gather", "Gather", "Gatherv", "bcast"}
_PACKAGE = Path(fem_snh.__file__).parent
_GATHERED = 4


class GatherProfile:
    """The bytes that this rank gathers by each line of the package, by `sys.setprofile`.

    Attributes
    ----------
    largest : Counter
        Bytes of a line's largest call.
    """

    def __init__(self) -> None:
        self.largest: Counter[str] = Counter()
        self._before = 0.0

    def __call__(self, frame: FrameType, event: str, function: Any) -> None:
        """Follow a call; Python calls this."""
        if not event.startswith("c_") or getattr(function, "__name__", "") not in _GATHERING:
            return
        if event == "c_call":
            self._before = counts()[_GATHERED]
            return
        gathered = int(counts()[_GATHERED] - self._before)
        caller: FrameType | None = frame
        while caller and Path(caller.f_code.co_filename) == _PACKAGE / "errors.py":
            caller = caller.f_back  # `on_root` and `on_every` gather for their callers
        if caller and (file := Path(caller.f_code.co_filename)).is_relative_to(_PACKAGE):
            line = f"{file.relative_to(_PACKAGE)}:{caller.f_lineno}"
            self.largest[line] = max(self.largest[line], gathered)


def counts() -> np.ndarray:
    """Return messages, their bytes, collectives, their bytes and gathered bytes of this rank."""
    library = ctypes.CDLL(os.environ["LD_PRELOAD"])
    library.mpi_counts.restype = ctypes.POINTER(ctypes.c_double)
    return np.array(library.mpi_counts()[:5])


def main(file: Path, scene: str, settings: dict[str, Any]) -> None:
    """Run the scene and write the counts of all ranks. Collective."""
    comm, before, profile = MPI.COMM_WORLD, counts(), GatherProfile()
    sys.setprofile(profile)
    record = fem_snh.run(scene, progress=False, **settings).record
    sys.setprofile(None)
    sent = counts() - before
    ranks = comm.gather({"sent": sent.tolist(), "largest": profile.largest})
    if ranks is not None:
        kept = {key: record[key] for key in ("dofs", "cells")}
        kept |= {"steps": len(record["steps"]), "converged": record["converged"]}
        file.write_text(json.dumps(kept | {"ranks": ranks}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], json.loads(sys.argv[3]))
