"""Wall-clock time of a sweep of small points beside the sum of their solves, and its memory."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import Row
from fem_snh.errors import BadInput

#: Time of the sweep relative to the sum of the times of its points, and growth of the memory of
#: the process that runs them.
LIMITS = {"ratio": 1.2, "growth": 1.1}


def rows(
    scene: str = "twist", cells: int = 10, points: int = 40, steps: int = 8, jobs: int = 1
) -> Iterator[Row]:
    """Sweep Poisson's ratio twice and yield one row of the second sweep, whose kernels are cached.

    Parameters
    ----------
    scene : str
        The scene.
    cells, steps : int
        Cells and load steps of each point.
    points : int
        Values of Poisson's ratio, from 0.3 to 0.45.
    jobs : int
        Points at a time; the sum is divided by it.

    Yields
    ------
    dict
        ``sweep [s]``: the whole command, with its start and its picture. ``points [s]``: the sum
        of the ``seconds`` of all run.json. ``growth``: peak memory of the last three points over
        that of the third to fifth.
    """
    values = [f"{nu:.6g}" for nu in np.linspace(0.3, 0.45, points)]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "fem_snh", "sweep", scene, "--nu", ",".join(values)]
        command += f"--cells {cells} --steps {steps} --jobs {jobs} --out {folder}/sweep".split()
        for _ in range(2):
            start = time.perf_counter()
            done = subprocess.run([*command, "--overwrite"], capture_output=True, text=True)
            seconds = time.perf_counter() - start
            if done.returncode:
                raise BadInput(f"benchmark sweep: {done.stderr.strip()[-300:]}")
        names = [f"nu={float(value)}" for value in values]
        records = [json.loads(Path(folder, "sweep", n, "run.json").read_text()) for n in names]
    solves = sum(record["seconds"]["total"] for record in records) / jobs
    memory = [record["peak_memory_mb"] for record in records]
    row = {"ratio": seconds / solves, "growth": max(memory[-3:]) / max(memory[2:5])}
    yield {
        "scene": scene,
        "cells": cells,
        "points": points,
        "jobs": jobs,
        "sweep [s]": round(seconds, 2),
        "points [s]": round(solves, 2),
        **{key: round(value, 3) for key, value in row.items()},
        "limits": LIMITS,
        "ok": all(row[key] <= limit for key, limit in LIMITS.items()),
    }
