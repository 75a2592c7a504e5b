"""The benchmark ``extremes``: its cases, their verdicts, and the table of docs/results."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from paths import ROOT

from benchmarks.extremes import FAMILIES, crush, loads, rows, scramble, supports
from benchmarks.extremes.cases import COLUMNS, at_rest, converged, ends_clearly, scene_case
from benchmarks.extremes.tight import agrees

pytestmark = pytest.mark.one_debian


# --- verdicts ------------------------------------------------------------------------------------

STEP = {"load": 1.0, "converged": True}
#: A row and a record of a run that came home.
HOME: dict[str, Any] = {
    "converged": True, "status": "converged", "steps": 1, "newton": 30, "max_u": 1e-9,
    "energy": 1e-17, "min_J": 1.0, "volume_ratio": 1.0,
}  # fmt: skip
RECORD: dict[str, Any] = {
    "steps": [STEP],
    "modes": {"frequencies": [0.04]},
    "material": {"parameters": {"mu": 0.3, "lam": 17.0}},
}
HALF = {"steps": [{"load": 0.5, "converged": True, "energy": 2.0}]}
STOPPED = "stopped at load 0.5: a step of 1/64 of the nominal one still fails (DIVERGED_MAX_IT)"
NOTE = {"kind": "supports", "text": "nothing constrains the body: all; it is one of many"}
POINT = HOME | {"min_J": 0.0, "volume_ratio": 0.0, "energy": 8.35}


def modes(frequency: float) -> dict[str, Any]:
    return RECORD | {"modes": {"frequencies": [frequency]}}


@pytest.mark.parametrize(
    ("check", "record", "row", "message"),
    [
        (converged, RECORD, HOME | {"converged": False, "status": "stopped"}, "stopped"),
        (converged, {"steps": [STEP] * 3}, HOME, "3 steps instead of 1"),
        (at_rest, RECORD, HOME, ""),
        (ends_clearly, HALF, HOME | {"converged": False, "status": STOPPED}, ""),
        (ends_clearly, {"steps": []}, HOME | {"converged": False, "status": STOPPED}, "no reason"),
        (at_rest, RECORD, HOME | {"max_u": 2e-6}, "another equilibrium: max |u| 2e-06"),
        (crush._rest, RECORD, HOME | {"max_u": 2.0}, ""),  # turned by half
        (crush._rest, modes(-0.1), HOME, "ends elsewhere"),
        (crush._left_the_state, RECORD, POINT, "volume 0, lowest frequency 0.04"),
        (crush._rest_or_point, modes(-1e-8), POINT, ""),
        (crush._rest_or_point, RECORD, POINT, "ends elsewhere"),
        (crush._minimum_point, RECORD, POINT, ""),
        (crush._minimum_point, modes(0.0), POINT, "it is no minimum"),
        (crush._unstable_point, modes(-1e-8), POINT, ""),
        (crush._unstable_point, RECORD, POINT, "it is a minimum"),
        (loads._few, RECORD, HOME | {"newton": 41}, "41 Newton iterations"),
        (agrees, {}, HOME | {"difference": 0.011}, "the tight solve differs by 0.011"),
        (agrees, {}, HOME | {"difference": float("nan")}, "the tight solve differs by nan"),
        (partial(supports._ends, "held"), {"notes": [NOTE]}, HOME, "nothing constrains the body"),
        (partial(supports._ends, "one of many"), {"notes": [NOTE]}, HOME, ""),
        (partial(supports._ends, "one of many"), {}, HOME, "no note on supports"),
    ],
)
def test_a_verdict(check: Any, record: Any, row: Any, message: str) -> None:
    why = check(record, row)
    assert why.startswith(message) and bool(why) == bool(message)


# --- the benchmark -------------------------------------------------------------------------------


def test_a_failure_is_a_row_that_is_not_ok(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = scene_case("twist", "loads-twist-Q1", "fails", lambda *_: "it fails", cells=2, steps=1)
    other = replace(case, name="loads-other-Q1", required=False)
    monkeypatch.setattr(loads, "cases", lambda quick, seeds: [case, other])
    found = list(rows(only="loads", write=str(tmp_path / "extremes.csv")))
    assert [row.get("ok") for row in found] == [False, None]
    assert [row["reason"] for row in found] == ["it fails"] * 2
    table = pd.read_csv(tmp_path / "extremes.csv")
    assert list(table.columns) == list(COLUMNS) and list(table["expected"]) == ["pass", "may fail"]


def test_the_page_has_the_numbers_of_the_table() -> None:
    table = pd.read_csv(ROOT / "docs" / "results" / "extremes" / "extremes.csv")
    text = (ROOT / "docs" / "results" / "extremes.md").read_text()
    assert list(table.columns) == list(COLUMNS) and not set(table["family"]) ^ set(FAMILIES)
    must = table[table["expected"] == "pass"]
    other = table[table["expected"] == "may fail"]
    assert f"{must['passed'].sum()} of {len(must)}" in text
    assert f"{other['passed'].sum()} of {len(other)}" in text
    for family, group in must.groupby("family"):
        (line,) = (line for line in text.splitlines() if line.startswith(f"| {family} |"))
        assert f"| {group['passed'].sum()} of {len(group)} |" in line
    assert set(scramble.median_criteria(must).values()) == {""}
