"""Run the extremes: every case in a process of its own, one row each, and a page.

The folder holds extremes.json (the definition), extremes.csv (a row is appended when a case ends),
extremes.md with its pictures, and one folder per case with its log and record. An interrupted study
continues when it is called again, also with more families or seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.errors import check_whole, choose
from fem_snh.studies.batch import Batch
from fem_snh.studies.extremes import FAMILIES, page
from fem_snh.studies.extremes.cases import COLUMNS, PASS, Case
from fem_snh.studies.point import Limits

#: Largest number of scrambled cubes: at seconds for each, such a study takes about a day.
MAX_SEEDS = 10_000


@dataclass(frozen=True)
class Outcome:
    """The results of the requested cases.

    Attributes
    ----------
    table : pandas.DataFrame
        One row per case.
    aggregate : dict
        Criteria of several cases together: {criterion: the reason of a failure, or ""}.
    """

    table: pd.DataFrame
    aggregate: dict[str, str]

    @property
    def failures(self) -> dict[str, str]:
        """Return the cases and criteria that are expected to pass and fail, with the reasons."""
        failed = self.table[(self.table["expected"] == PASS) & ~self.table["passed"]]
        return dict(zip(failed["point"], failed["reason"], strict=True)) | {
            criterion: reason for criterion, reason in self.aggregate.items() if reason
        }

    @property
    def required(self) -> int:
        """Return the number of criteria that are expected to pass."""
        return int((self.table["expected"] == PASS).sum()) + len(self.aggregate)


def extremes(
    out: str | Path,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    seeds: int = 100,
    material: str = "",
    report: Callable[[str], None] = print,
    **limits: Any,
) -> Outcome:
    """Run the requested cases that have no row yet and return the results of all.

    Parameters
    ----------
    out : str | Path
        The folder; a study that it holds is continued.
    only : sequence of str
        Families; default: all.
    quick : bool
        A few small cases of each family, in minutes.
    seeds : int
        Scrambles of each small cube.
    material : str
        Name of a material, or ``FILE.py:NAME`` for one of your own. Its pointwise errors must be
        within their bounds; its runs may fail, as the theory of the page is that of Stable
        Neo-Hookean. Default: every built-in material pointwise, Stable Neo-Hookean in the runs.
    report : callable
        Called with one line per case, and with the path of the page.
    limits : Any
        Jobs, timeout, memory, retry, overwrite, as for `fem_snh.studies.sweep.sweep`.

    Raises
    ------
    BadInput
        Before anything runs: for a bad value, or if ``out`` holds another study.
    """
    for family in only:
        choose("family", family, FAMILIES)
    check_whole("seeds", seeds, 1, MAX_SEEDS)
    flags = {key: limits.pop(key, False) for key in ("retry", "overwrite")}
    families = [import_module(f"{__package__}.{family}") for family in only or FAMILIES]
    chosen: list[list[Case]] = [family.cases(quick, seeds, material) for family in families]
    cases = {case.name: case for family in chosen for case in family}
    definition = {"quick": quick, "material": material}
    batch = Batch(
        out, "extremes", definition, COLUMNS, Limits(**limits),
        inputs=[file for case in cases.values() for file in case.point.files()],
        success="passed", report=report, **flags,
    )  # fmt: skip

    def evaluate(record: Mapping[str, Any], row: Mapping[str, Any]) -> Mapping[str, Any]:
        return cases[row["point"]].evaluate(record, row)

    with batch:
        batch.run({name: case.point for name, case in cases.items()}, evaluate)
        table = pd.read_csv(batch.table.path)
        batch.draw()
        report(f"page: {page.write(table, batch.out)}")
    requested = table[table["point"].isin(list(cases))]
    return Outcome(requested, page.aggregate_criteria(requested))
