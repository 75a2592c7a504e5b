"""The stretch on more and more ranks: iterations, messages, work and memory of a Newton iteration.

Counts do not depend on the machine, and there may be more ranks than cores. A model makes seconds
of them: those of one rank by what the busiest one does, and the network's by the messages.
"""

from __future__ import annotations

import json
import math
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil

from benchmarks import Row, search_path, split_list
from fem_snh.errors import BadInput
from fem_snh.studies.processes import environment, program

#: Largest linear iterations of up to so many ranks over those of one.
LIMIT, UP_TO = 1.3, 16
#: Floating-point operations of a linear iteration: for a block above the diagonal, which both
#: sweeps multiply by; for one in other ranks' columns; for a pair of the coarse space, whose image
#: is multiplied twice.
_UPPER, _SHARED, _PAIR = 36, 18, 144


def rows(
    parts: str = "strong,weak",
    ranks: str = "1,2,4,8,16,32",
    cells: int = 28,
    weak_cells: int = 16,
    stretch: float = 1.4,
    subdomains: int = -1,
    replicated: int = -1,
    timeout: float = 900.0,
) -> Iterator[Row]:
    """Yield one row per part and number of ranks: a load step of the stretch, nu = 0.49.

    Parameters
    ----------
    parts : comma list
        strong: the same body; weak: one with as many cells per rank.
    ranks : comma list
        Numbers of ranks, from 1.
    cells, weak_cells : int
        Along the diameter; 28: 58,551 unknowns. Of a weak part: on one rank.
    stretch : float
        Ratio of the lengths at the end.
    subdomains, replicated : int
        ``-ksp_deflation_subdomains`` and ``-ksp_deflation_replicated``; -1: the defaults.
    timeout : float
        Limit of a run [s].

    Yields
    ------
    dict
        ``ratio``: linear iterations over those of one rank; ``energy_difference``: relative.
        Of the rank that sends most, per Newton iteration: ``messages``, ``message_kB``,
        ``collectives``, ``collective_kB``. ``mflop``: of a linear iteration on all ranks, and
        ``imbalance`` of it, the largest over the mean; ``cells_imbalance`` likewise.
        ``memory_mb``: of all ranks. ``predicted_seconds``: by the model, were there a core for each
        rank; ``seconds``: measured, where there is.
    """
    given = {"deflation_subdomains": subdomains, "deflation_replicated": replicated}
    petsc = {f"ksp_{name}": value for name, value in given.items() if value >= 0}
    with tempfile.TemporaryDirectory() as name:
        library = _library(Path(name))
        for part in split_list(parts):
            if part not in ("strong", "weak"):
                raise BadInput(f"parts = '{part}': expected some of strong, weak")
            runs: list[dict[str, Any]] = []
            for number in map(int, split_list(str(ranks))):
                size = cells if part == "strong" else _even(weak_cells * number ** (1 / 3))
                settings = {"cells": size, "stretch": stretch, "petsc": petsc}
                runs.append(_run(number, settings, library, timeout))
                row: Row = {"part": part, "ranks": number} | _counts(runs[-1]) | _seconds(runs)
                if part == "strong":
                    row["ratio"] = round(runs[-1]["linear"] / runs[0]["linear"], 2)
                    row["energy_difference"] = abs(runs[-1]["energy"] / runs[0]["energy"] - 1)
                    row["ok"] = row["ratio"] <= LIMIT or number > UP_TO
                yield row


def _library(folder: Path) -> Path:
    """Compile what counts the messages."""
    source, target = Path(__file__).with_name("mpi_counter.c"), folder / "counter.so"
    command = ["mpicc", "-shared", "-fPIC", "-O2", str(source), "-lmpi_mpifh", "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise BadInput(f"benchmark scaling: mpicc failed: {done.stderr.strip()[-300:]}")
    return target


def _run(ranks: int, settings: dict[str, Any], library: Path, timeout: float) -> dict[str, Any]:
    """Return what `benchmarks.counted_ranks` writes."""
    file = library.with_suffix(".json")
    command = [*program(ranks, "benchmarks.counted_ranks"), str(file), json.dumps(settings)]
    env = environment() | search_path() | {"LD_PRELOAD": str(library)}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=timeout)
    if done.returncode:
        reason = done.stderr.strip()[-300:]
        raise BadInput(f"benchmark scaling: {settings} on {ranks} ranks failed: {reason}")
    found: dict[str, Any] = json.loads(file.read_text())
    return found


def _counts(run: dict[str, Any]) -> Row:
    """Return the columns that do not depend on the machine."""
    newton, work = run["newton"], _work(run)
    sent = [max(of["sent"][kind] for of in run["ranks"]) / newton for kind in range(4)]
    cells = [of["cells"] for of in run["ranks"]]
    return {
        "dofs": run["dofs"],
        "newton": newton,
        "linear": run["linear"],
        "messages": round(sent[0]),
        "message_kB": round(sent[1] / 1e3),
        "collectives": round(sent[2]),
        "collective_kB": round(sent[3] / 1e3),
        "mflop": round(sum(work) / 1e6, 2),
        "imbalance": round(max(work) * len(work) / sum(work), 3),
        "cells_imbalance": round(max(cells) * len(cells) / sum(cells), 3),
        "memory_mb": round(sum(of["memory_mb"] for of in run["ranks"])),
    }


def _seconds(runs: list[dict[str, Any]]) -> Row:
    """Return the model's prediction, and the measured seconds where there is a core for a rank.

    What one rank takes for a cell and for an operation is that of the first run; what the network
    takes, that of two ranks.
    """
    run, one = runs[-1], runs[0]["ranks"][0]
    found: Row = {}
    if len(run["ranks"]) <= (psutil.cpu_count(logical=False) or 1):
        found["seconds"] = round(max(of["seconds"] for of in run["ranks"]), 3)
    if len(runs[0]["ranks"]) > 1:
        return found
    network = next((of for of in runs if len(of["ranks"]) == 2), runs[0])
    newton, linear = runs[0]["newton"], runs[0]["linear"]
    per_cell = (one["seconds"] - one["ksp_seconds"]) / (newton * one["cells"])
    per_flop = (one["ksp_seconds"] / linear - one["coarse_seconds"]) / _work(runs[0])[0]
    coarse = network["ranks"][-1]["coarse_seconds"] if len(run["ranks"]) > 1 else 0.0
    sent = [max(of["sent"][kind] for of in run["ranks"]) for kind in range(4)]
    stages = math.ceil(math.log2(len(run["ranks"])))
    predicted = (
        per_cell * run["newton"] * max(of["cells"] for of in run["ranks"])
        + run["linear"] * (per_flop * max(_work(run)) + (coarse or one["coarse_seconds"]))
        + network["latency"] * sent[0]
        + network["seconds_per_byte"] * sent[1]
        + stages * (network["sum_seconds"] * sent[2] + network["seconds_per_byte"] * sent[3])
    )
    return found | {"predicted_seconds": round(predicted, 3)}


def _work(run: dict[str, Any]) -> list[float]:
    """Return the floating-point operations of a linear iteration on each rank."""
    return [
        _UPPER * of["upper_blocks"] + _SHARED * of["shared_blocks"] + _PAIR * of["coarse_pairs"]
        for of in run["ranks"]
    ]


def _even(number: float) -> int:
    """Return the nearest even number."""
    return 2 * round(number / 2)
