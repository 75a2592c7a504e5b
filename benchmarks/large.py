"""One load step of the stretch on large meshes: iterations, seconds and memory by element."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row, split_list
from benchmarks.stretch_times import run_apart, summary
from fem_snh.errors import choose

#: Poisson's ratio and cells along the diameter: 8e6 unknowns of P2, 1e6 of Q2Q1 and 2e6 of P2P1.
CASES = {"P2": (0.49, 74), "Q2Q1": (0.5, 36), "P2P1": (0.5, 46)}
#: Limit of the memory of all ranks [GB], per million unknowns for the mixed elements.
MEMORY, MEMORY_PER_MILLION = {"P2": 22 * 1.073741824}, {"Q2Q1": 7.0, "P2P1": 5.0}


def rows(
    elements: str = "P2,Q2Q1,P2P1",
    cells: int = 0,
    stretch: float = 1.2,
    steps: int = 1,
    ranks: int = 2,
    timeout: float = 3600.0,
    memory: float = 22.0,
) -> Iterator[Row]:
    """Yield one row per element.

    Parameters
    ----------
    cells : int
        Along the diameter; 0: those of `CASES`.
    stretch, steps : float, int
        Ratio of the lengths at the end, and the number of load steps.
    timeout, memory : float
        Limits of a run [s], [GiB].

    Yields
    ------
    dict
        ``seconds``: of the load steps; ``setup``: mesh, numbering and sparsity pattern. ``gb``: the
        peak of all ranks together.
    """
    for element in split_list(elements):
        nu, chosen = CASES[choose("element", element, CASES)]
        settings = {"element": element, "nu": nu, "cells": int(cells) or chosen}
        settings |= {"stretch": stretch, "steps": int(steps)}
        record, status = run_apart({}, settings, int(ranks), timeout, memory)
        row: Row = {"element": element, "nu": nu, "cells": settings["cells"]}
        row |= summary(record, status)
        parts, gb = record.get("seconds", {}), row.pop("peak_memory_mb") / 1000
        row["setup"] = round(parts.get("mesh", 0) + parts.get("setup", 0), 1)
        row["gb"], row["gb_per_million"] = gb, round(gb / max(row["dofs"], 1) * 1e6, 2)
        within = gb <= MEMORY.get(element, gb)
        within &= row["gb_per_million"] <= MEMORY_PER_MILLION.get(element, float("inf"))
        yield row | {"ok": row["converged"] and within}
