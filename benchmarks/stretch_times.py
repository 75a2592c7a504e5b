"""The whole stretch by three solvers: the recipe of Smith et al. 2018, FEniCSx's tutorial, ours.

Each run has processes of its own, one run after another, within limits of time and memory.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks import Row, search_path, split_list
from fem_snh.errors import choose
from fem_snh.processes import Interrupts
from fem_snh.studies.points import read_record, run_arguments
from fem_snh.studies.tasks import Child, program

#: Settings of `fem-snh run` (None: `benchmarks.fenicsx_tutorial`), and the divisor of the number of
#: load steps.
WAYS: dict[str, tuple[dict[str, Any] | None, int]] = {
    "ours": ({}, 1),
    "ours, a third of the steps": ({}, 3),
    "ours to the tolerance": ({"petsc": {"snes_forcing_safeguard": 0.25}}, 1),
    "paper": (
        {
            "hessian": "clamp",
            "globalization": "linesearch",
            "petsc": {"pc_type": "jacobi", "snes_forcing_max": 0.0, "ksp_rtol": 1e-5},
        },
        1,
    ),
    "tutorial": (None, 1),
}
#: Required speed-up over these, and the degrees of freedom from which it is required.
LIMITS = {"paper": (6.0, 20_000), "tutorial": (10.0, 40_000)}


def rows(
    cells: str = "20,25,40",
    ways: str = "",
    nu: float = 0.49,
    steps: int = 12,
    ranks: int = 2,
    timeout: float = 3600.0,
    memory: float = 12.0,
) -> Iterator[Row]:
    """Yield one row per mesh and solver.

    Parameters
    ----------
    cells : str
        Along the diameter: 20, 25, 40 and 72 give 2e4, 4e4, 1.6e5 and 9.8e5 unknowns.
    timeout, memory : float
        Limits of a run [s], [GiB].

    Yields
    ------
    dict
        ``seconds``: of the load steps, without meshing and compilation. ``to_ours``: ratio of the
        seconds to ours, up to the load that both runs reached. ``residual``: in E V^(2/3).
    """
    for number in split_list(str(cells)):
        ours: dict[str, Any] | None = None
        for way in [choose("way", w, WAYS) for w in split_list(ways)] or WAYS:
            given, one_in = WAYS[way]
            settings = {"cells": int(number), "nu": nu, "steps": max(steps // one_in, 1)}
            record, ended = run_apart(given, settings, int(ranks), timeout, memory)
            row: Row = {"way": way, "nu": nu, "ranks": ranks} | summary(record, ended)
            ours = ours or record
            if record is not ours and row["load"] > 0:
                row["to_ours"] = round(_until(record, row["load"]) / _until(ours, row["load"]), 2)
            if way in LIMITS and row.get("dofs", 0) >= LIMITS[way][1]:
                row["limit"] = LIMITS[way][0]
                row["ok"] = not row["converged"] or row.get("to_ours", 0) >= row["limit"]
            yield row


def run_apart(
    way: dict[str, Any] | None, settings: dict[str, Any], ranks: int, timeout: float, memory: float
) -> tuple[dict[str, Any], str]:
    """Return the record of a run in processes of its own, and its status."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if way is None:
            start = program(ranks, "benchmarks.fenicsx_tutorial")
            command = [*start, str(folder), json.dumps({"scene": "stretch"} | settings)]
        else:
            values = {key: value for key, value in way.items() if key != "petsc"}
            petsc = way.get("petsc", {})
            command = [
                *program(ranks),
                *run_arguments("stretch", folder / "out", settings | values, petsc),
            ]
            folder = folder / "out"
        limit_reached = run_child(command, Path(name, "log.txt"), timeout, memory, search_path())
        record = read_record(folder)
        lines = Path(name, "log.txt").read_text().strip().splitlines()
    ended = limit_reached or ("converged" if record.get("converged") else "")
    return record, ended or record.get("status") or (lines[-1] if lines else "failed")


def run_child(
    command: list[str], log: Path, timeout: float, memory: float, env: dict[str, str]
) -> str:
    """Run a command in processes of its own; return the limit that ended it, if one did."""
    with Interrupts() as interrupts:  # Ctrl-C does not reach a child, which has its own session
        with interrupts.postponed():
            child = Child(command, log, timeout, memory, env)
        try:
            while child.poll() is None:
                time.sleep(0.1)
        finally:
            child.end()
    return child.limit_reached


def summary(record: dict[str, Any], ended: str) -> Row:
    """Return the columns of a run: its record and status are those of `run_apart`."""
    good = [step for step in record.get("steps", ()) if step["converged"]]
    every = record.get("steps", ())
    return {
        "dofs": record.get("dofs", 0),
        "converged": bool(record.get("converged")),
        "status": ended,
        "load": good[-1]["load"] if good else 0.0,
        "steps": len(good),
        "failed_steps": len(every) - len(good),
        "newton": sum(step["newton"] for step in every),
        "linear": sum(step["linear"] for step in every),
        "residual": good[-1]["residual"] if good else None,
        "seconds": round(sum(step["seconds"] for step in every), 2),
        "peak_memory_mb": round(record.get("peak_memory_mb", 0)),
    }


def _until(record: dict[str, Any], load: float) -> float:
    """Return the seconds up to ``load``, with the share of the step that passes it."""
    seconds, reached = 0.0, 0.0
    for step in record["steps"]:
        if reached >= load - 1e-9:
            break
        part = 1.0
        if step["converged"]:
            part = min(1.0, (load - reached) / (step["load"] - reached))
            reached = step["load"]
        seconds += part * step["seconds"]
    return seconds
