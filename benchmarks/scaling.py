"""The stretch on more and more ranks: iterations, messages, work and memory of a Newton iteration.

Counts do not depend on the machine, and there may be more ranks than cores. A model turns them into
seconds: what one rank takes for a cell, an operation of the sweeps and a coarse solve, and what the
network takes for messages and collectives. It needs Open MPI's mpicc.
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
from benchmarks.stretch_times import run_child
from fem_snh.errors import BadInput
from fem_snh.studies.tasks import program

#: Largest linear iterations of up to so many ranks over those of one.
LIMIT, UP_TO = 1.3, 16
#: Floating-point operations of a linear iteration: for a block above the diagonal, which both
#: sweeps multiply by; for one in other ranks' columns; for a pair of the coarse space, whose image
#: is multiplied twice. The coarse solve is not among them.
_UPPER, _SHARED, _PAIR = 36, 18, 144

Run = dict[str, Any]


def rows(
    parts: str = "strong,weak",
    ranks: str = "1,2,4,8,16,32",
    cells: int = 28,
    weak_cells: int = 16,
    stretch: float = 1.4,
    subdomains: int = -1,
    timeout: float = 900.0,
    memory: float = 16.0,
) -> Iterator[Row]:
    """Yield one row per part and number of ranks: a load step of the stretch, nu = 0.49.

    Parameters
    ----------
    parts : comma list
        strong: the same body; weak: one with as many cells per rank.
    ranks : comma list
        Numbers of ranks, 1 first. With 2 there are predictions.
    cells, weak_cells : int
        Along the diameter; 28: 58,551 unknowns. Of a weak part: on one rank.
    stretch : float
        Ratio of the lengths at the end.
    subdomains : int
        ``-ksp_deflation_subdomains``; -1: the default.
    timeout, memory : float
        Limits of a run [s], [GiB].

    Yields
    ------
    dict
        ``ratio``: linear iterations over those of one rank; ``energy_difference``: relative.
        Per Newton iteration, the largest of all ranks: ``messages``, ``message_kB``,
        ``collectives``, ``collective_kB``. ``mflop``: of the sweeps and of the coarse space's
        images in a linear iteration on all ranks; ``imbalance``: the largest of it over the mean,
        ``cells_imbalance`` likewise. ``coarse_ms``: of a coarse solve in one process, which every
        rank repeats. ``memory_mb``: of all ranks. ``predicted_seconds``: by the model, were there a
        core for each rank; ``seconds``: measured, where there is.
    """
    numbers = [int(number) for number in split_list(str(ranks))]
    if numbers[0] != 1:
        raise BadInput(f"ranks = '{ranks}': expected numbers of ranks, 1 first")
    given = {"deflation_subdomains": subdomains}
    petsc = {f"ksp_{name}": value for name, value in given.items() if value >= 0}
    with tempfile.TemporaryDirectory() as name:
        bench = _Bench(Path(name), {"stretch": stretch, "petsc": petsc}, timeout, memory)
        for part in split_list(parts):
            if part not in ("strong", "weak"):
                raise BadInput(f"parts = '{part}': expected some of strong, weak")
            runs: list[Run] = []
            for number in numbers:
                size = cells if part == "strong" else _even(weak_cells * number ** (1 / 3))
                runs.append(bench.run(number, size))
                row: Row = {"part": part, "ranks": number} | _counts(runs[-1])
                row |= _seconds(runs, bench)
                row["ok"] = runs[-1]["converged"]
                if part == "strong":
                    row["ratio"] = round(runs[-1]["linear"] / runs[0]["linear"], 2)
                    row["energy_difference"] = abs(runs[-1]["energy"] / runs[0]["energy"] - 1)
                    row["ok"] &= row["ratio"] <= LIMIT or number > UP_TO
                yield row


class _Bench:
    """Runs `benchmarks.counted_ranks` with the library that counts messages."""

    def __init__(
        self, folder: Path, settings: dict[str, Any], timeout: float, memory: float
    ) -> None:
        self._folder, self._settings, self._limits = folder, settings, (timeout, memory)
        self._coarse: dict[tuple[int, int], tuple[float, float]] = {}
        self._library = counting_library(folder)

    def run(self, ranks: int, cells: int, subdomains: int | None = None) -> Run:
        """Return what a run has counted."""
        settings = self._settings | {"cells": cells}
        if subdomains is not None:
            petsc = {"ksp_deflation_subdomains": subdomains}
            settings["petsc"] = settings["petsc"] | petsc
        module, words = "benchmarks.counted_ranks", (json.dumps(settings),)
        run = counted(self._folder, self._library, ranks, module, words, self._limits)
        return run | {"cells": cells}

    def coarse_seconds(self, run: Run) -> tuple[float, float]:
        """Return the seconds of an update and of a solve of a coarse matrix, in one process."""
        key = run["cells"], run["subdomains"]
        if key not in self._coarse:
            alone = run if len(run["ranks"]) == 1 else self.run(1, *key)
            own = alone["ranks"][0]
            self._coarse[key] = own["coarse_updates"] / alone["newton"], own["coarse_solve"]
        return self._coarse[key]


def counting_library(folder: Path) -> Path:
    """Compile the library that counts messages, and return its path.

    Raises
    ------
    BadInput
        If there is no mpicc, or it fails.
    """
    source, library = Path(__file__).with_name("mpi_counter.c"), folder / "counter.so"
    command = ["mpicc", "-shared", "-fPIC", "-O2", str(source), "-lmpi_mpifh"]
    done = subprocess.run(
        [*command, "-o", str(library)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise BadInput(f"benchmarks: mpicc failed: {done.stderr.strip()[-300:]}")
    return library


def counted(
    folder: Path,
    library: Path,
    ranks: int,
    module: str,
    words: tuple[str, ...],
    limits: tuple[float, float],
) -> Run:
    """Return what a module has counted on some ranks: the JSON in the file that it is given.

    Raises
    ------
    BadInput
        If it fails, or ends at one of the ``limits`` [s], [GiB].
    """
    file, log = folder / "counts.json", folder / "log.txt"
    file.unlink(missing_ok=True)
    command = [*program(ranks, module), str(file), *words]
    limit = run_child(command, log, *limits, search_path() | {"LD_PRELOAD": str(library)})
    if limit or not file.exists():
        reason = limit or log.read_text().strip()[-300:]
        raise BadInput(f"{module} {words} on {ranks} ranks: {reason}")
    run: Run = json.loads(file.read_text())
    return run


def _counts(run: Run) -> Row:
    """Return the columns that do not depend on the machine."""
    newton, work = run["newton"], _work(run)
    sent = [max(of["sent"][kind] for of in run["ranks"]) / newton for kind in range(4)]
    cells = [of["cells"] for of in run["ranks"]]
    return {
        "dofs": run["dofs"],
        "subdomains": run["subdomains"],
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


def _seconds(runs: list[Run], bench: _Bench) -> Row:
    """Return the measured seconds where there is a core for each rank, and those predicted.

    What one rank takes for a cell and for an operation is that of the first run; what the network
    takes, that of two ranks.
    """
    first, run = runs[0], runs[-1]
    one, number = first["ranks"][0], len(run["ranks"])
    row: Row = {}
    if number <= (psutil.cpu_count(logical=False) or 1):
        row["seconds"] = round(max(of["seconds"] for of in run["ranks"]), 3)
    pair = next((of for of in runs if len(of["ranks"]) == 2), None)
    if pair is None:
        return row
    newton, linear = first["newton"], first["linear"]
    coarse_of_one = newton * bench.coarse_seconds(first)[0] + linear * one["coarse_solve"]
    per_cell = (one["seconds"] - one["ksp_seconds"]) / (newton * one["cells"])
    per_flop = (one["ksp_seconds"] - coarse_of_one) / (linear * _work(first)[0])
    update, solve = bench.coarse_seconds(run)
    sent = [max(of["sent"][kind] for of in run["ranks"]) for kind in range(4)]
    stages = math.ceil(math.log2(number))
    predicted = (
        run["newton"] * (per_cell * max(of["cells"] for of in run["ranks"]) + update)
        + run["linear"] * (per_flop * max(_work(run)) + solve)
        + pair["latency"] * sent[0]
        + pair["seconds_per_byte"] * sent[1]
        + stages * (pair["sum_seconds"] * sent[2] + pair["seconds_per_byte"] * sent[3])
    )
    return row | {"coarse_ms": round(1e3 * solve, 2), "predicted_seconds": round(predicted, 3)}


def _work(run: Run) -> list[float]:
    """Return the floating-point operations of a linear iteration on each rank."""
    return [
        _UPPER * of["upper_blocks"] + _SHARED * of["shared_blocks"] + _PAIR * of["coarse_pairs"]
        for of in run["ranks"]
    ]


def _even(number: float) -> int:
    """Return the nearest even number."""
    return 2 * round(number / 2)
