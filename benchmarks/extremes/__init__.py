"""Robustness of the solver: scrambled, crushed, overloaded, badly shaped and badly held bodies.

A family of cases is a module of `FAMILIES` with a function ``cases(quick, seeds)``; its docstring
says what is tested and what theory predicts. Every case is a run of a scene in a process of its
own. Cases of the last families are solved again more tightly (``tight.py``): nothing that they call
converged is contradicted by more than 1 %. Materials at one point: the benchmark ``pointwise``.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pandas as pd

from benchmarks import Row, split_list
from benchmarks.extremes.cases import COLUMNS, Case
from benchmarks.extremes.scramble import median_criteria
from benchmarks.extremes.tight import tight_row
from fem_snh.errors import check_whole, choose

#: In the order of the table.
FAMILIES = (
    "scramble", "crush", "loads", "drop", "press",
    "contrast", "aspect", "supports", "rigid", "small_force",
)  # fmt: skip
#: Largest number of scrambled cubes: at seconds for each, they take about a day.
MAX_SEEDS = 10_000


def rows(only: str = "", quick: bool = False, seeds: int = 100, write: str = "") -> Iterator[Row]:
    """Run every case; all of them take some four hours, the quick ones minutes.

    Parameters
    ----------
    only : str
        Comma list of `FAMILIES`; default: all.
    quick : bool
        A few small cases of each family.
    seeds : int
        Scrambles of each small cube.
    write : str
        CSV file for the rows: docs/results/extremes/extremes.csv.

    Yields
    ------
    dict
        The columns `COLUMNS` of each case, with ``ok`` if it must pass, and one row for each
        criterion of several cases together.
    """
    names = [choose("family", name, FAMILIES) for name in split_list(only)] or FAMILIES
    check_whole("seeds", seeds, 1, MAX_SEEDS)
    done: list[Row] = []
    for name in names:
        for case in import_module(f"{__name__}.{name}").cases(quick, seeds):
            for row in results(case):
                done.append({key: row.get(key) for key in COLUMNS})
                yield done[-1] | ({"ok": row["passed"]} if case.required else {})
    table = pd.DataFrame(done, columns=COLUMNS)
    for criterion, reason in median_criteria(table).items():
        yield {"criterion": criterion, "reason": reason, "ok": not reason}
    if write:
        table.to_csv(write, index=False)


def results(case: Case) -> Iterator[Row]:
    """Run a case, and yield its row and the row of its tight solve, if it has one."""
    out = Path(tempfile.mkdtemp(prefix="fem-snh-extremes-"))
    try:
        record, row = case.run(out)
        yield row | case.verdict(record, row)
        if case.tight and row["converged"]:
            yield tight_row(case, out)
    finally:
        shutil.rmtree(out)
