"""Errors of a table, the Pareto front, advice, and settings for a required accuracy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tradeoff_rows import OF, assessed, by_hand, row

from benchmarks import tradeoff_tables
from fem_snh import scenes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.studies.tradeoff import accuracy, advice, errors
from fem_snh.studies.tradeoff.knobs import Choice


def test_errors_are_of_what_converged_against_the_finest() -> None:
    lines: list[str] = []
    table = errors.assess(by_hand(), OF, lines.append)
    q1 = table[table["element"] == "Q1"]["error_displacement"]
    assert q1.tolist() == pytest.approx([0.5, 0.25, 0.125], rel=1e-3)
    assert table["error_energy"][0] == pytest.approx(0.5, rel=1e-3)
    assert np.isnan(table["error_displacement"].iloc[-1])  # that did not converge
    assert table["shift"].iloc[-2] == pytest.approx(1e-5, rel=1e-2)
    assert table["shift"][0] == 0
    by_quantity = {line.partition(":")[0]: line for line in lines}
    assert "order 3.00" in by_quantity["energy"] and "Q2Q1 up to 16 cells" in by_quantity["energy"]
    assert "rejected" in by_quantity["volume"] and table["error_volume"].isna().all()
    assert "reaction" not in by_quantity


def test_without_three_meshes_there_is_no_error() -> None:
    table = by_hand().iloc[:5]
    found = errors.assess(table, OF, lambda line: None)
    assert found["error_displacement"].isna().all()
    assert list(advice.sentences(found)) == [
        "hand, nu = 0.3: the reference is not accurate enough, no recommendation"
    ]
    assert advice.advice(found).empty


@given(st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9)), min_size=1, max_size=20))
def test_nothing_beats_the_front(pairs: list[tuple[int, int]]) -> None:
    rows = pd.DataFrame(pairs, columns=["cpu", "error"], dtype=float)
    kept = advice.pareto_front(rows)
    assert kept["cpu"].is_monotonic_increasing and kept["error"].is_monotonic_decreasing
    for cpu, error in pairs:
        assert ((kept["cpu"] <= cpu) & (kept["error"] <= error)).any()
    for _, best in kept.iterrows():
        better = (rows["cpu"] <= best["cpu"]) & (rows["error"] <= best["error"])
        assert not (better & (rows[["cpu", "error"]] != best[["cpu", "error"]]).any(axis=1)).any()


def test_advice_in_words() -> None:
    five, one, tenth = advice.sentences(assessed(), (0.2, 0.01, 1e-9))
    assert five.startswith("hand, nu = 0.3, 20 % of displacement: use Q2Q1, 2 cells: ")
    assert "0.08 s, 1.2 times the cheapest; Q1 takes 51 times that" in five
    assert "Q1 does not reach it: 16 cells, 51 times that, 13 %" in one
    assert "unknown, the reference resolves errors above" in tenth
    lines = advice.by_element(assessed(), (0.2,))
    assert [line[:3] for line in lines] == [
        ["0.3", "Q1", "4.1 s (16 cells)"], ["0.3", "Q2Q1", "0.08 s (2 cells)"]
    ]  # fmt: skip


def test_advice_is_a_table_to_choose_from(tmp_path: Path) -> None:
    table = assessed()
    for name, content in {"advice": advice.advice(table), "tradeoff": table}.items():
        path = tmp_path / f"{name}.csv"
        content.to_csv(path, index=False)
        chosen = accuracy.choose("hand", 0.2, 0.05, path)
        assert (chosen.choice.element, chosen.choice.cells, chosen.nu) == ("Q2Q1", 2, 0.3)
        assert chosen.cpu == 0.08 and chosen.error < 0.05
        assert chosen.choice == Choice("Q2Q1", 2, steps=2)
    with pytest.raises(BadInput, match=r"up to 0\.3, not nu = 0\.4"):
        accuracy.choose("hand", 0.4, 0.05, path)
    with pytest.raises(BadInput, match=r"accuracy = 1e-07 %: the best of .* at nu = 0\.3 is"):
        accuracy.choose("hand", 0.3, 1e-9, path)
    with pytest.raises(BadInput, match=r"cells = 9 contradicts --accuracy, .*cells = 2"):
        chosen.values({"cells": 9})
    assert chosen.choice.solver == "automatic"
    slower = Choice("Q2Q1", 2, solver="minres+hypre").values()
    assert slower["petsc.ksp_type"] == "minres" and slower["petsc.fieldsplit_u_pc_type"] == "hypre"


@pytest.mark.parametrize("text, number", [("1%", 0.01), ("5 %", 0.05), ("0.01", 0.01), (0.2, 0.2)])
def test_an_accuracy(text: Any, number: float) -> None:
    assert accuracy.fraction(text) == pytest.approx(number)


@pytest.mark.parametrize("text", ["1", "0", "-1%", "200%", "fine", "nan", ""])
def test_no_accuracy(text: str) -> None:
    with pytest.raises(BadInput, match=r"expected per cent or a fraction, e\.g\. 1% or 0\.01"):
        accuracy.fraction(text)


def test_a_scene_has_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At a lower nu than any that was measured, the row of the lowest."""
    words = ["run", "cook", "--nu", "0.2", "--accuracy", "5%", "--out", str(tmp_path)]
    assert main(words) == 0
    output = capsys.readouterr().out
    assert output.startswith("accuracy: ") and "at nu = 0.3 (cook.csv)" in output
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["accuracy"]["error"] <= 0.05 and record["accuracy"]["asked"] == 0.05
    assert record["material"]["nu"] == 0.2
    assert record["accuracy"]["hessian"] in ("automatic", record["hessian"])


@pytest.mark.parametrize("scene", ["cook"])
def test_tables_of_the_package(scene: str) -> None:
    """Where the default is nearly incompressible, one per cent is to be had."""
    nu = scenes.load(scene).material.nu
    chosen = accuracy.choose(scene, nu, 0.01)
    assert chosen.error <= 0.01 and chosen.nu >= nu and chosen.table == f"{scene}.csv"
    coarser = accuracy.choose(scene, nu, 0.1)
    assert coarser.cpu < chosen.cpu
    scenes.load(scene, **chosen.values({}))
    with pytest.raises(BadInput, match="contradicts"):
        chosen.values({"element": "Q1"})


def test_a_page_is_filled_from_its_tables() -> None:
    table = assessed()
    kinds = {kind: tradeoff_tables.TABLES[kind](table) for kind in tradeoff_tables.TABLES}
    assert "| Q1 | 8 | 512 | 25 % |" in kinds["locking"]
    assert "| Q1 | 5 % | never |\n" in kinds["price"]
    assert "| Q2Q1 | 5 % | 0.08 (2) |\n" in kinds["price"]
    assert "| Q2Q1 | 8 | 1 |" in kinds["iterations"]
    assert "| 0.3 | Q2Q1 | 4 | clamp | 1 | 1 | x 1.6 | 1e-05 |" in kinds["knobs"]
    assert "| 0.3 | Q2Q1 | 4 |  | 1, x 1.6 |  |  | 1, x 1 |" in kinds["filters"]
    text = "a\n<!-- table: hand price -->\nold\n<!-- end -->\nb\n"
    filled = tradeoff_tables.fill(text, {"hand": table})
    assert (
        filled
        == text.replace("old", kinds["price"])
        == tradeoff_tables.fill(filled, {"hand": table})
    )
    for wrong in ("hans price", "hand prize"):
        with pytest.raises(BadInput, match=r"did you mean '(hand|price)'"):
            tradeoff_tables.fill(text.replace("hand price", wrong), {"hand": table})


@pytest.mark.parametrize("scene", ["cook", "stretch", "twist"])
def test_every_row_of_a_packaged_table_can_be_run(scene: str) -> None:
    for nu in (0.2, 0.4999, 0.5):
        chosen = accuracy.choose(scene, nu, 0.5)
        loaded = scenes.load(scene, nu=nu, **chosen.values({}))
        assert loaded.element == chosen.choice.element and loaded.petsc["snes_scaled_tol"]
        assert nu < 0.5 or ELEMENTS[loaded.element].volume == "pressure"


def test_the_bound_contains_the_error_of_the_reference() -> None:
    """Values that converge to 1, with orders mixed so that the extrapolated reference is off.

    With the distance to the reference alone, the bound of some row is below its true error.
    """
    rows = [row("Q1", n, 1 - 0.4 / n) for n in (4, 8, 16)]
    rows += [row("Q2Q1", n, 1 - 0.2 / n - 0.3 / n**3) for n in (2, 4, 8, 16)]
    table = errors.assess(pd.DataFrame(rows), OF, lambda line: None)
    true = abs(table["p.x"] - 1)
    known = table["error_displacement"].notna()
    assert known.sum() == len(rows)
    bounds = pd.Series([errors.error_bound(line) for line in table.to_dict("records")])
    assert (bounds >= true).all()
    without = np.maximum(table["error_displacement"], table["floor_displacement"])
    assert (without < true).any()
    own = table["floor_displacement"] / 10
    measured = table["error_displacement"] >= table["floor_displacement"]
    expected = (table["error_displacement"] + own) / (1 - own)
    assert bounds[measured].tolist() == pytest.approx(expected[measured].tolist(), rel=1e-12)


def saved(folder: Path, **columns: Any) -> Path:
    """A table with these columns changed."""
    path = folder / "advice.csv"
    advice.advice(assessed()).assign(**columns).to_csv(path, index=False)
    return path


def test_a_table_of_another_scene_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = saved(tmp_path)
    words = ["run", "block", "--nu", "0.3", "--accuracy", "20%", "--accuracy-table", str(path)]
    assert main(words) == 2
    assert "it is of the scene hand, not of block" in capsys.readouterr().err
    saved(tmp_path, scene="block", mesh="other.msh", cells=None)
    assert main(words) == 2
    assert "it is of mesh files, other.msh, and block generates its mesh" in capsys.readouterr().err


def test_a_table_of_another_mesh_is_refused(toml: Path) -> None:
    """The scene's mesh is known by its content: in the study, or among the table's meshes."""
    folder = toml.parent
    for name in ("block.msh", "same.msh", "other.msh"):
        (folder / name).write_text("other" if name == "other.msh" else "mesh")
    own = scenes.load(toml).model_copy(update={"mesh": folder / "block.msh", "name": "hand"})
    for name, accepted in (("same.msh", True), ("other.msh", False), ("gone.msh", False)):
        path = saved(folder, mesh=str(folder / name), cells=None)
        if accepted:
            assert accuracy.choose("hand", 0.3, 0.2, path, own).choice.mesh == str(folder / name)
            continue
        with pytest.raises(BadInput, match=r"mesh = .*block\.msh: expected the mesh"):
            accuracy.choose("hand", 0.3, 0.2, path, own)
    digest = accuracy.file_digest(folder / "block.msh")
    (folder / "tradeoff.json").write_text(json.dumps({"files": {"block.msh": digest}}))
    assert accuracy.choose("hand", 0.3, 0.2, path, own).choice.mesh.endswith("gone.msh")


def test_every_changed_setting_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also the number of load steps, on a line and in run.json."""
    path = saved(tmp_path, scene="block", steps=2)
    words = ["run", "block", "--nu", "0.3", "--accuracy", "20%", "--accuracy-table", str(path)]
    assert main([*words, "--out", str(tmp_path / "run")]) == 0
    line = capsys.readouterr().out.splitlines()[1]
    assert line.startswith("accuracy: changes of the scene: ")
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    changed = record["accuracy"]["changed"]
    assert changed["element"] == ["Q2", "Q2Q1"] and changed["steps"] == [4, 2]
    assert changed["cells"] == [8, 2]
    for key, (old, new) in changed.items():
        assert f"{key} = {new}" in line and (old is None or f"{key} = {new} for {old}" in line)
