"""``fem-snh extremes``: cases and their verdicts, the table, the page, exit codes."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.studies.extremes import (
    FAMILIES,
    aspect,
    bodies,
    contrast,
    crush,
    drop,
    loads,
    pointwise,
    press,
    rigid,
    scramble,
    small_force,
    supports,
)
from fem_snh.studies.extremes.cases import COLUMNS, at_rest, converged, scene_case
from fem_snh.studies.extremes.pointwise import all_rows_pass
from fem_snh.studies.extremes.study import Robustness, extremes
from fem_snh.studies.extremes.tight import agrees, with_tight

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
NOTE = {"kind": "supports", "text": "nothing constrains the body: all; it is one of many"}
POINT = HOME | {"min_J": 0.0, "volume_ratio": 0.0, "energy": 8.35}


def modes(frequency: float) -> dict[str, Any]:
    return RECORD | {"modes": {"frequencies": [frequency]}}


@pytest.mark.parametrize(
    ("check", "record", "row", "message"),
    [
        (converged, RECORD, HOME, ""),
        (converged, RECORD, HOME | {"converged": False, "status": "stopped"}, "stopped"),
        (converged, {"steps": [STEP] * 3}, HOME, "3 steps instead of 1"),
        (at_rest, RECORD, HOME, ""),
        (at_rest, RECORD, HOME | {"max_u": 2e-6}, "another equilibrium: max |u| 2e-06"),
        (at_rest, RECORD, HOME | {"max_u": float("nan")}, "another equilibrium"),
        (crush._rest, RECORD, HOME | {"max_u": 2.0}, ""),  # turned by half
        (crush._rest, RECORD, HOME | {"energy": 1e-3}, "ends elsewhere"),
        (crush._rest, RECORD, HOME | {"min_J": -1.0}, "ends elsewhere"),
        (crush._rest, modes(-0.1), HOME, "ends elsewhere"),
        (crush._left_the_state, RECORD, HOME | {"energy": 0.1, "volume_ratio": 0.98}, ""),
        (crush._left_the_state, RECORD, POINT, "volume 0, lowest frequency 0.04"),
        (crush._rest_or_point, RECORD, HOME, ""),
        (crush._rest_or_point, modes(-1e-8), POINT, ""),
        (crush._rest_or_point, RECORD, POINT, "ends elsewhere"),
        (crush._minimum_point, RECORD, POINT, ""),
        (crush._minimum_point, RECORD, POINT | {"energy": 8.0}, "its energy is 8"),
        (crush._minimum_point, modes(0.0), POINT, "it is no minimum"),
        (crush._minimum_point, RECORD, HOME, "it left"),
        (crush._unstable_point, modes(-1e-8), POINT, ""),
        (crush._unstable_point, RECORD, POINT, "it is a minimum"),
        (loads._stays_at_rest, RECORD, HOME, ""),
        (loads._stays_at_rest, RECORD, HOME | {"max_u": 0.1}, "it moved by 0.1"),
        (loads._few, RECORD, HOME, ""),
        (loads._few, RECORD, HOME | {"newton": 41}, "41 Newton iterations"),
        (all_rows_pass, {"rows": [{"passed": True}]}, {}, ""),
        (agrees, {}, HOME | {"difference": 0.009}, ""),
        (agrees, {}, HOME | {"difference": 0.011}, "the tight solve differs by 0.011"),
        (agrees, {}, HOME | {"difference": float("nan")}, "the tight solve differs by nan"),
        (agrees, {}, HOME | {"converged": False, "status": "stopped"}, "the tight solve fails: st"),
        (partial(supports._ends, "held"), {"notes": [NOTE]}, HOME, "nothing constrains the body"),
        (partial(supports._ends, "one of many"), {"notes": [NOTE]}, HOME, ""),
        (partial(supports._ends, "one of many"), {}, HOME, "no note on supports"),
        (partial(supports._ends, "refused"), {}, HOME, "converged"),
    ],
)
def test_a_verdict(check: Any, record: Any, row: Any, message: str) -> None:
    why = check(record, row)
    assert why.startswith(message) and bool(why) == bool(message)


def test_a_case_without_a_record_fails() -> None:
    case = loads.cases(True, 1)[0]
    row = {"converged": False, "status": "given up after 1 s", "steps": 1}
    result = {"passed": False, "reason": "given up after 1 s", "remark": "failed"}
    assert case.evaluate({}, row) == result


def test_what_several_must_fulfil() -> None:
    rows = pd.DataFrame({"element": ["Q1", "Q1", "Q1", "P1"], "newton": [100, 160, 170, 30]})
    rows = rows.assign(expected="pass", cells=15, nu=0.49, family="scramble")
    found = scramble.aggregate_criteria(rows)
    assert list(found.values()) == ["", "it is 160"] and all("15^3" in asked for asked in found)
    table = rows.assign(point=list("abcd"), passed=[True, False, True, True], reason="because")
    table.loc[0, "expected"], table.loc[0, "passed"] = "may fail", False
    assert list(Robustness(table, found).failures) == ["b", list(found)[1]]


#: The families that solve each case tightly, too.
TIGHT = [contrast, aspect, rigid, small_force]
RUNS = [scramble, crush, loads, drop, press, supports, *TIGHT]


@pytest.mark.parametrize("family", RUNS)
@pytest.mark.parametrize("quick", [True, False])
def test_every_case_has_a_name_of_its_own(family: Any, quick: bool) -> None:
    made = family.cases(quick, 2)
    names = [case.name for case in made]
    assert len(set(names)) == len(names) and {case.family for case in made} == {
        family.__name__.rpartition(".")[2]
    }
    assert any(case.required for case in made)


def test_the_issues_cases_are_there() -> None:
    must = [case for case in scramble.cases(False, 100) if case.required]
    assert sum("-10-" in case.name for case in must) == 2 * 5 * 100
    assert sum("-15-" in case.name for case in must) == 2 * 5 * 10
    made = {case.name for case in loads.cases(False, 1) if case.required}
    assert len(made) == 7 * 3 + 2 * 4 and "loads-twist-pi-nu0.3-Q1-15-trust" in made


# --- cases of their own --------------------------------------------------------------------------


def test_a_pointwise_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [
        {"group": "regular", "quantity": "pk1", "passed": False},
        {"group": "regular", "quantity": "energy", "passed": True},
    ]
    monkeypatch.setattr(pointwise, "measure", lambda *arguments: rows)
    assert pointwise.main("stvk", str(tmp_path / "case")) == 0
    record = json.loads((tmp_path / "case" / "record.json").read_text())
    (case,) = pointwise.cases(False, 1, "stvk")
    row = case.point.measured(record, tmp_path / "log.txt", 0)
    assert row["status"] == "1 of 2 pass" and row["seconds"] >= 0
    assert all_rows_pass(record, row) == "regular pk1"
    (tmp_path / "log.txt").write_text("a\nlast words\n")
    failed = case.point.measured({}, tmp_path / "log.txt", 1)
    assert failed["status"] == "exit code 1: last words"
    assert not case.evaluate({}, {"status": "ended by signal 9"})["passed"]


# --- whole studies -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Robustness]:
    out = tmp_path_factory.mktemp("extremes")
    return out, extremes(out, only=["loads"], quick=True, jobs=2)


def test_a_study_is_a_table_and_a_page(done: tuple[Path, Robustness]) -> None:
    out, outcome = done
    assert outcome.failures == {}
    table = pd.read_csv(out / "extremes.csv")
    assert tuple(table.columns) == COLUMNS and len(table) == 6 and table["passed"].all()
    measures = ["converged", "newton", "clamped", "linear", "min_J", "residual", "nonfinite"]
    assert not table[[*measures, "seconds", "max_u"]].isna().any(axis=None)
    turned = table[table["point"].str.contains("2pi")]
    # one iteration: the rounding error is not known before a Hessian is assembled
    assert (turned["newton"] <= 1).all() and (turned["max_u"] < 1e-12).all()
    text = (out / "extremes.md").read_text()
    assert (
        "6 of the 6 cases that are expected to pass do" in text
        and "## Large loads in one step" in text
    )
    assert (out / "extremes.png").stat().st_size > 1000


def test_notes_are_a_column(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Q1 locks at nu = 0.4999, at 0.3 it does not; a material's own measurement has no notes."""
    some = [
        scene_case(
            "twist", f"loads-{nu}", "reaches its load", converged,
            nu=nu, cells=2, element="Q1", steps=1, angle=0.3,
        )
        for nu in (0.3, 0.4999)
    ]  # fmt: skip
    monkeypatch.setattr(loads, "cases", lambda quick, seeds, material: some)
    table = extremes(tmp_path, only=["loads", "pointwise"], material="stvk", quick=True).table
    notes = dict(zip(table["point"], table["notes"], strict=True))
    record = json.loads((tmp_path / "loads-0.4999" / "run.json").read_text())
    kinds = [note["kind"] for note in record["notes"]]
    assert kinds and notes["loads-0.4999"] == " ".join(kinds)
    assert notes["loads-0.3"] == notes["pointwise-stvk"] == "none"


GENT = """
from sympy import log

def gent(I_C, J, mu, lam, *, limit=50.0):
    stretch = -mu * limit / 2 * log(1 - (I_C - 3) / limit)
    return stretch - mu * (J - 1) + lam / 2 * (J - 1) ** 2
"""


def test_a_material_of_ones_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its pointwise errors must be within their bounds; no theory predicts its runs."""
    (tmp_path / "gent.py").write_text(GENT)
    material, out = f"{tmp_path / 'gent.py'}:gent", tmp_path / "out"
    for family in RUNS:
        made = family.cases(True, 1, material)
        assert made and not any(case.required for case in made)
        names = {case.point.requested()["material"] for case in made}
        assert {name for found in names for name in found.split(" + ")} == {material}
    words = ["extremes", "--quick", "--only", "pointwise", "--material", material]
    assert main([*words, "--out", str(out)]) == 0
    assert "1 of 1 that are expected to pass do" in capsys.readouterr().out
    (row,) = pd.read_csv(out / "extremes.csv").to_dict("records")
    assert row["passed"] and row["material"] == material and row["expected"] == "pass"
    with pytest.raises(BadInput, match=r"material = .*genz"):
        extremes(out, quick=True, material=f"{tmp_path / 'gent.py'}:genz")


def test_a_study_goes_on_where_it_was(done: tuple[Path, Robustness]) -> None:
    out, outcome = done
    lines: list[str] = []
    again = extremes(out, only=["loads"], quick=True, report=lines.append)
    pd.testing.assert_frame_equal(again.table, outcome.table)
    assert lines[0] == "6 of 6 points are there already"
    with pytest.raises(BadInput, match=r"holds extremes.csv of other quick.*--overwrite"):
        extremes(out, only=["loads"])


def test_every_case_of_the_tight_families_has_a_tight_solve() -> None:
    for family in TIGHT:
        made = {case.name: case for case in family.cases(False, 1)}
        tight = {case.point.after: name for name, case in made.items() if case.point.after}
        assert set(tight) | set(tight.values()) == set(made) and len(tight) == len(made) / 2
    assert len(FAMILIES) == len(RUNS) + 1


def test_a_stiff_inclusion_a_small_force_and_a_free_body(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The difference that the study finds is that of the runs; a coarse tolerance is caught."""
    loose = {"petsc.snes_scaled_tol": 1e-2}
    inclusion = bodies.reference(bodies.inclusion)
    keys = {"contrast": 1e4, "cells": 3, "shape": "bar", "nu": 0.3}
    some = [
        *with_tight(scene_case(inclusion, "contrast-a-Q1", "reaches its load", converged, **keys)),
        *with_tight(
            scene_case(
                inclusion, "contrast-loose-Q1", "reaches its load", converged, **keys, **loose
            )
        ),
    ]
    refused = [case for case in supports.cases(True, 1) if case.name == "supports-too-few"]
    monkeypatch.setattr(contrast, "cases", lambda *arguments: some)
    monkeypatch.setattr(supports, "cases", lambda *arguments: refused)
    small = small_force.cases(True, 1)
    monkeypatch.setattr(small_force, "cases", lambda *arguments: small)
    out = tmp_path / "out"
    study = extremes(out, only=["contrast", "supports", "small_force"], quick=True, jobs=2)
    assert list(study.failures) == ["contrast-loose-tight-Q1"]
    table = study.table.set_index("point")
    assert table.loc["contrast-a-tight-Q1", "difference"] < 1e-4
    ends = [
        json.loads((out / name / "run.json").read_text())["steps"][-1]
        for name in ("contrast-loose-Q1", "contrast-loose-tight-Q1")
    ]
    force = [np.array(end["reactions"]["right"]) for end in ends]
    least = np.abs(force[0] - force[1]).max() / np.abs(force[1]).max()
    assert table.loc["contrast-loose-tight-Q1", "difference"] >= least > 0.01
    assert "the tight solve differs by" in (out / "extremes.md").read_text()


def test_what_fails_is_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    some = loads.cases(True, 1)[:1]
    monkeypatch.setattr(loads, "cases", lambda quick, seeds, material: some)
    words = ["extremes", "--quick", "--only", "loads", "--out", str(tmp_path)]
    assert main([*words, "--timeout", "0.05"]) == 1
    output = capsys.readouterr().out
    assert f"failed: {some[0].name}: given up after 0.05 s" in output
    assert (
        "0 of 1 that are expected to pass do" in output
        and "Failed:" in (tmp_path / "extremes.md").read_text()
    )
    assert main(words) == 1  # it has its row
    monkeypatch.setattr(loads, "cases", lambda quick, seeds, material: [])
    assert main([*words, "--retry"]) == 0  # it is not asked for, and stays
    assert some[0].name in (tmp_path / "extremes.csv").read_text()
    monkeypatch.setattr(loads, "cases", lambda quick, seeds, material: some)
    assert main([*words, "--retry"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--only scrambel", "family = 'scrambel': expected one of ... (did you mean 'scramble'?)"),
        ("--seeds 0", "seeds = 0: expected a whole number from 1 to 10000"),
        ("--seeds many", "seeds = 'many': expected a whole number from 1 to 10000"),
        ("--jobs 0", "jobs = 0"),
        ("--timeout soon", "timeout = soon"),
        ("--quik", "unknown option '--quik': expected one of ... (did you mean '--quick'?)"),
        ("here", "unexpected 'here'"),
    ],
)
def test_mistakes(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["extremes", "--out", str(tmp_path / "new"), *words.split()]) == 2
    output = capsys.readouterr().err
    assert all(part in output for part in message.split("...")) and output.count("\n") == 1
    assert not (tmp_path / "new").exists()
