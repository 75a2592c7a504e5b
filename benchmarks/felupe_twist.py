"""The twist beside FElupe: seconds of a half turn, without the start of either program.

It needs felupe and pypardiso (``pip install felupe pypardiso``), here or in an environment of their
own, whose Python the option ``python`` names.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks import Row, split_list
from fem_snh.errors import BadInput
from fem_snh.studies.tasks import environment, program

#: Seconds of FElupe over those of this program, at least, by cells along an edge.
LIMITS = {15: 25.0, 25: 60.0}


def rows(
    cells: str = "15,25",
    quarters: int = 2,
    substeps: int = 10,
    ranks: int = 2,
    python: str = sys.executable,
    forcing: float = 0.1,
) -> Iterator[Row]:
    """Yield one row per mesh.

    Parameters
    ----------
    cells : comma list
        Hexahedra along an edge of the cube.
    quarters : int
        Quarter turns; each is one load step here.
    substeps : int
        Load steps of FElupe for each of them: it needs several, as its Newton method has neither a
        line search nor a filter.
    ranks : int
        MPI ranks here, and threads of FElupe.
    python : str
        The Python that has FElupe.
    forcing : float
        Largest relative tolerance of a linear solve here, by default that of other scenes: 5e-3 of
        the scene twist is for counts that do not depend on rounding.

    Yields
    ------
    dict
        Seconds of the load steps, without imports, mesh and compilation; each program has its own
        Neo-Hookean energy of the same E and nu, and its default tolerance. The processor time
        is summed over ranks or threads; here it includes the mesh and the output. It is comparable
        where other programs use the machine.
    """
    for number in map(int, split_list(cells)):
        theirs = run_felupe("felupe_program.py", python, [number, quarters, substeps], ranks)
        ours = _run(number, quarters, ranks, forcing)
        seconds = sum(step["seconds"] for step in ours["steps"])
        # Where FElupe stops early, its time is a lower bound.
        ratio = theirs["seconds"] / seconds
        row: Row = {
            "cells": number,
            "quarter_turns": quarters,
            "ranks": ranks,
            "seconds": round(seconds, 3),
            "newton": [step["newton"] for step in ours["steps"]],
            "felupe_seconds": round(theirs["seconds"], 2),
            "processor_seconds": round(ours["processor_seconds"], 2),
            "felupe_processor_seconds": round(theirs["processor_seconds"], 2),
            "felupe_newton": sum(theirs["newton"]),
            "felupe_status": f"{theirs['status']}, {theirs['turned']:g} degrees",
            "felupe_version": theirs["version"],
            "ratio": round(ratio, 1),
            "processor_ratio": round(theirs["processor_seconds"] / ours["processor_seconds"], 1),
        }
        if (limit := LIMITS.get(number)) and (quarters, substeps) == (2, 10):
            row |= {"limit": limit, "ok": ours["converged"] and ratio >= limit}
        yield row


def run_felupe(
    name: str, python: str, arguments: Sequence[object], threads: int = 1
) -> dict[str, Any]:
    """Return what a program beside this module, which uses FElupe, prints: one JSON object.

    Raises
    ------
    BadInput
        If this Python does not have FElupe.
    """
    path = Path(__file__).with_name(name)
    names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
    done = subprocess.run(
        [python, str(path), *map(str, arguments)],
        env=os.environ | dict.fromkeys(names, str(threads)),
        capture_output=True,
        text=True,
    )
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise BadInput(
            f"python = {python}: expected a Python with FElupe, pip install felupe pypardiso "
            f"({reason})"
        )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def _run(cells: int, quarters: int, ranks: int, forcing: float) -> dict[str, Any]:
    """Return the record (run.json) of this program's run."""
    with tempfile.TemporaryDirectory() as folder:
        words = f"run twist --cells {cells} --steps {quarters} --quiet --out {folder}/run".split()
        angle = f"--set=angle={quarters * 1.5707963267948966}"
        done = subprocess.run(
            [*program(ranks), *words, angle, "--", "-snes_forcing_max", str(forcing)],
            env=environment(),
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise BadInput(f"benchmark felupe_twist: {done.stderr.strip()[-300:]}")
        record: dict[str, Any] = json.loads(Path(folder, "run", "run.json").read_text())
    return record
