"""Seconds of a Newton step of mixed elements over those of Q1 with as many unknowns."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import Row, split_list
from fem_snh.errors import choose
from fem_snh.runs import run

#: Cells across the cylinder by element, for about as many unknowns.
CELLS: dict[str, dict[str, int]] = {
    "2000": {"Q1": 9, "Q1P0": 9, "P2P0": 4, "P2P1": 4, "Q2Q1": 4},
    "40000": {"Q1": 24, "Q1P0": 24, "P2P0": 12, "P2P1": 12, "Q2Q1": 12},
    "180000": {"Q1": 40, "Q1P0": 40, "P2P0": 20, "P2P1": 20, "Q2Q1": 20},
    "600000": {"Q1": 60, "Q1P0": 60, "P2P0": 30, "P2P1": 29, "Q2Q1": 29},
}
#: Fewest unknowns for which the limits hold.
_SMALLEST = 40_000
#: Largest ratios.
LIMITS = {"Q2Q1": 3.0, "P2P1": 2.5, "Q1P0": 2.5, "P2P0": 2.5}
#: The stretch by 20 % in one step.
_SETTINGS: dict[str, Any] = {"steps": 1, "stretch": 1.2}


def rows(
    sizes: str = "40000,180000",
    elements: str = "Q2Q1,P2P1,Q1P0,P2P0",
    nu: float = 0.4999,
    rounds: int = 3,
) -> Iterator[Row]:
    """Yield one row per size and element; first Q1 at nu = 0.49.

    The elements run in turn, in several rounds, as a machine is not equally fast at all times; the
    fastest run of each counts.

    Yields
    ------
    dict
        Newton and linear iterations, seconds of a Newton step, and their ratio to those of Q1 for
        each unknown.
    """
    for size in split_list(sizes):
        cells = CELLS[choose("size", size, CELLS)]
        limits = {choose("element", of, LIMITS): LIMITS[of] for of in split_list(elements)}
        runs = {"Q1": 0.49} | dict.fromkeys(limits, nu)
        measured = [[_row(of, cells[of], runs[of]) for of in runs] for _ in range(rounds)]
        fastest = [min(of, key=lambda row: row["seconds"]) for of in zip(*measured, strict=True)]
        first = fastest[0]
        yield first
        for row, limit in zip(fastest[1:], limits.values(), strict=True):
            row["ratio"] = round(row["microseconds"] / first["microseconds"], 2)
            small = int(size) < _SMALLEST  # a matter of milliseconds
            yield row | ({} if small else {"limit": limit, "ok": row["ratio"] <= limit})


def _row(element: str, cells: int, nu: float) -> Row:
    """Return the measurements of one run; the microseconds are for each Newton step and unknown."""
    result = run("stretch", element=element, cells=cells, nu=nu, progress=False, **_SETTINGS)
    (step,) = result.steps
    dofs = result.record["dofs"]
    row: Row = {"element": element, "cells": cells, "nu": nu, "dofs": dofs}
    row |= {"newton": step["newton"], "linear": step["linear"]}
    row["seconds"] = round(step["seconds"] / step["newton"], 3)
    return row | {"microseconds": round(1e6 * step["seconds"] / step["newton"] / dofs, 2)}
