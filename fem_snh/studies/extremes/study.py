"""The study: every case in a process of its own, a row each, a page.

The folder holds extremes.json (what was asked), extremes.csv (a row the moment a case ends),
extremes.md with its pictures, and a folder for each case with its log and record. Call it again and
it goes on where it was ended, also with more families or seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.errors import BadInput, choose
from fem_snh.studies.campaign import Campaign, Limits
from fem_snh.studies.extremes import FAMILIES, measured, page
from fem_snh.studies.extremes.cases import COLUMNS, Case

#: Families whose cases measure by themselves.
_OWN = ("pointwise", "faults")


@dataclass(frozen=True)
class Outcome:
    """What came out of the cases asked for.

    Attributes:
        table: a row for each.
        demands: what is asked of several together, in words: why it does not hold, or "".
    """

    table: pd.DataFrame
    demands: dict[str, str]

    @property
    def failures(self) -> dict[str, str]:
        """What must hold and does not, with the reason."""
        bad = self.table[self.table["must"] & ~self.table["holds"]]
        return dict(zip(bad["point"], bad["why"], strict=True)) | {
            asked: why for asked, why in self.demands.items() if why
        }


def extremes(
    out: str | Path,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    seeds: int = 100,
    report: Callable[[str], None] = print,
    **limits: Any,
) -> Outcome:
    """Run the cases that are not there yet; what came out of all that are asked for.

    Args:
        out: the folder; a study that was begun there goes on.
        only: families; none: all.
        quick: a few small cases of each, in minutes.
        seeds: scrambles of each small cube.
        report: gets a line per case, and where the page is.
        limits: jobs, timeout, memory, retry, overwrite, as of `fem_snh.studies.sweep`.

    Raises:
        BadInput: before anything runs: a bad value, or another study in ``out``.
    """
    for family in only:
        choose("family", family, FAMILIES)
    if not isinstance(seeds, int) or isinstance(seeds, bool) or seeds < 1:
        raise BadInput(f"seeds = {seeds}: expected a whole number, 1 or more")
    flags = {key: limits.pop(key, False) for key in ("retry", "overwrite")}
    chosen = {family: _cases(family, quick, seeds) for family in only or FAMILIES}
    cases = {case.name: case for family in chosen.values() for case in family}
    campaign = Campaign(
        Path(out), "extremes", {"quick": quick}, COLUMNS, Limits(**limits),
        good="holds", report=report, **flags,
    )  # fmt: skip

    def judged(record: Mapping[str, Any], row: Mapping[str, Any]) -> Mapping[str, Any]:
        return cases[row["point"]].judged(record, row)

    campaign.run({name: case.point for name, case in cases.items()}, judged)
    table = pd.read_csv(campaign.table.path)
    campaign.draw()
    report(f"page: {page.write(table, Path(out))}")
    asked = table[table["point"].isin(list(cases))]
    return Outcome(asked, page.demands(asked))


def _cases(family: str, quick: bool, seeds: int) -> list[Case]:
    if family in _OWN:
        return measured.cases(family, quick)
    made: list[Case] = import_module(f"{__package__}.{family}").cases(quick, seeds)
    return made
