"""The stretch on more and more ranks: iterations and memory, which do not depend on the machine."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row, split_list
from benchmarks.stretch_times import run_apart, summary

#: Largest linear iterations of 16 ranks over those of one.
LIMIT = 1.3


def rows(
    ranks: str = "1,2,4,8,16",
    cells: int = 28,
    stretch: float = 1.4,
    steps: int = 1,
    timeout: float = 900.0,
    memory: float = 16.0,
) -> Iterator[Row]:
    """Yield one row per number of ranks; there may be more ranks than cores.

    Parameters
    ----------
    ranks : comma list
        Numbers of ranks; each is compared with the first.
    cells : int
        Along the diameter; 28: 58,551 unknowns.
    stretch, steps : float, int
        Ratio of the lengths at the end, and the number of load steps.
    timeout, memory : float
        Limits of a run [s], [GiB].

    Yields
    ------
    dict
        ``ratio``: linear iterations over those of the first row. ``energy_difference``: relative to
        it.
    """
    first: Row = {}
    for number in split_list(ranks):
        settings = {"cells": int(cells), "stretch": stretch, "steps": int(steps)}
        record, status = run_apart({}, settings, int(number), timeout, memory)
        row: Row = {"ranks": int(number)} | summary(record, status)
        row["energy"] = record["steps"][-1]["energy"] if row["converged"] else None
        first = first or row
        if row["converged"] and first["converged"]:
            row["ratio"] = round(row["linear"] / first["linear"], 2)
            row["energy_difference"] = abs(row["energy"] / first["energy"] - 1)
        yield row | {"ok": row["converged"] and row["ratio"] <= LIMIT}
