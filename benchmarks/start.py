"""Processor time of a run whose kernels and mesh are in the cache, beside its imports."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from resource import RUSAGE_CHILDREN, getrusage

import numpy as np

from benchmarks import Row

#: The packages that no solve can do without; only a mesh that the cache has not needs gmsh.
_IMPORTS = (
    "import dolfinx.fem.petsc, _cffi_backend, platformdirs; "
    "from pydantic import BaseModel, PositiveFloat, validate_call"
)
#: Processor time of the run relative to the imports alone.
LIMIT = 1.4


def rows(scene: str = "twist", cells: int = 2, repeat: int = 5) -> Iterator[Row]:
    """Start a small run and the imports alone, in turns: one row with the median of the ratios.

    Parameters
    ----------
    scene : str
        The scene.
    cells : int
        Its cells.
    repeat : int
        Starts of each kind, after one that fills the cache and writes byte code.
    """
    run = [sys.executable, "-m", "fem_snh", "run", scene, "--cells", str(cells)]
    processor_seconds(run)
    pairs = np.array(
        [
            [processor_seconds([sys.executable, "-c", _IMPORTS]), processor_seconds(run)]
            for _ in range(repeat)
        ]
    )
    ratio = float(np.median(pairs[:, 1] / pairs[:, 0]))
    imports, whole = np.median(pairs, axis=0)
    yield {
        "scene": scene,
        "cells": cells,
        "imports [s]": round(float(imports), 3),
        "run [s]": round(float(whole), 3),
        "ratio": round(ratio, 3),
        "limit": LIMIT,
        "ok": ratio <= LIMIT,
    }


def processor_seconds(command: list[str]) -> float:
    """Return the processor time [s] of a command, user and system."""
    before = getrusage(RUSAGE_CHILDREN)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
