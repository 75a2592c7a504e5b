"""The trade of accuracy against time: references, refusals, fronts, advice, and a whole study."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import tradeoff_tables
from fem_snh import plots, scenes
from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.fem import gmsh_input
from fem_snh.fem.elements import ELEMENTS
from fem_snh.studies.processes import environment
from fem_snh.studies.tradeoff import accuracy, advice, errors
from fem_snh.studies.tradeoff.grid import Plan, changed_knobs, middle_resolution, resolutions
from fem_snh.studies.tradeoff.knobs import KNOBS, SOLVERS, Choice, knob_values
from fem_snh.studies.tradeoff.reference import (
    Reference,
    establish,
    estimate,
    extrapolate,
    mesh_sequence,
    observed_order,
    reference_message,
)  # fmt: skip
from fem_snh.studies.tradeoff.study import tradeoff

# --- references ----------------------------------------------------------------------------------


def values(h: list[float], p: float, limit: float = 3.0, amount: float = 0.2) -> list[np.ndarray]:
    return [np.array([limit + amount * width**p, 1 - amount * width**p]) for width in h]


@given(
    st.floats(0.9, 3.9), st.lists(st.floats(1.2, 3.0), min_size=2, max_size=4), st.floats(0.05, 0.3)
)
def test_richardson_finds_order_and_limit(p: float, ratios: list[float], amount: float) -> None:
    """Whatever the ratios of the widths, which need not be the same."""
    h = [1.0]
    for ratio in ratios:
        h.append(h[-1] / ratio)
    found = values(h, p, amount=amount)
    assert observed_order(h[-3:], found[-3:]) == pytest.approx(p, abs=1e-4)
    limit, order = extrapolate(h, found)
    assert limit == pytest.approx([3, 1], abs=1e-5) and order == pytest.approx(p, abs=1e-4)


def test_no_order_no_extrapolation() -> None:
    """Differences that do not fall, or hardly: the finest value, and an error of their size."""
    h = [1.0, 0.5, 0.25]
    growing = [np.array([v]) for v in (1.0, 1.1, 1.3)]
    found = estimate("Q2", "4 cells", h, growing)
    assert found is not None and found.value == [1.3] and np.isnan(found.order)
    assert found.error == pytest.approx(0.2 / 1.3)
    slow = [np.array([v]) for v in (1.0, 1.1, 1.19)]
    assert extrapolate(h, slow)[0] == [1.19]
    assert np.isnan(observed_order(h, [np.ones(1)] * 3))
    assert estimate("Q2", "2 cells", h[:2], growing[:2]) is None


def test_meshes_that_are_spread() -> None:
    """A mesh between two others is for advice, not for the order."""
    assert mesh_sequence([1 / n for n in (2, 4, 8, 16, 24, 32, 64)]) == [0, 1, 2, 3, 5, 6]
    assert mesh_sequence([1 / n for n in (2, 3, 4, 6)]) == [0, 1, 2, 3]


def test_an_order_that_is_chance_is_not_believed() -> None:
    """As order 9 would have it, the last value is the limit."""
    h = [1.0, 0.5, 0.25]
    limit, order = extrapolate(h, values(h, 9.0))
    assert order == pytest.approx(9, abs=1e-3)
    last, before = values(h, 9.0)[-1], values(h, 9.0)[-2]
    assert limit - last == pytest.approx((last - before) / (2**4 - 1))


def reference(value: float, error: float, element: str = "Q2") -> Reference:
    return Reference(np.array([value]), error, error, element, "8 cells", 2.0)


def test_a_second_element_may_raise_the_error() -> None:
    assert establish([]) is None
    alone = establish([reference(1.0, 0.01)])
    assert alone is not None and alone.error == 0.01 and not alone.checked
    agreed = establish([reference(1.0, 0.02, "Q2"), reference(1.01, 0.01, "Q2Q1")])
    assert agreed is not None and (agreed.element, agreed.checked) == ("Q2Q1", "Q2")
    assert agreed.error == 0.01
    apart = establish([reference(1.0, 0.01), reference(1.5, 0.02, "Q2Q1")])
    assert apart is not None and apart.error == pytest.approx(0.5 - 0.02)


def test_what_a_reference_cannot_resolve_is_rejected() -> None:
    good = reference(1.0, 0.001)
    assert reference_message("energy", good, {"a": 0.02}).endswith("resolves errors above 1 %")
    assert "rejected" in reference_message("energy", good, {"a": 0.009})
    assert "three meshes" in reference_message("energy", None, {})


# --- errors of a table ---------------------------------------------------------------------------

OF = errors.quantities([], ["p"])


def row(element: str, cells: int, x: float, cpu: float = 1.0, **more: Any) -> dict[str, Any]:
    choice = Choice(element, cells, **{k: v for k, v in more.items() if k in KNOBS})
    made = {
        "point": f"{element}-{cells}-{len(more)}", "scene": "hand", "nu": 0.3, "converged": True,
        "default": not more, "h": 1 / cells, "energy": 2 * x, "volume_ratio": 1.0, "cpu": cpu,
        "probe_p_x": x, "probe_p_y": 0.0, "probe_p_z": 0.0, "dofs": cells**3, "seconds": cpu,
        "newton": 1, "linear": 1, "peak_memory_mb": 1.0, "status": "as it is",
        "steps": 2,
    }  # fmt: skip
    return made | choice.row() | {k: v for k, v in more.items() if k not in KNOBS}


def by_hand() -> pd.DataFrame:
    """Q1 converges to 1 from 0.5, Q2 far faster; a filter costs half more for the same."""
    rows = [row("Q1", n, 1 - 2 / n, n**3 / 1e3) for n in (4, 8, 16)]
    rows += [row("Q2Q1", n, 1 - 0.02 / n**3, n**3 / 100) for n in (2, 4, 8, 16)]
    rows.append(row("Q2Q1", 4, 1 - 0.02 / 4**3 + 1e-5, 1.0, hessian="clamp"))
    rows.append(row("Q2Q1", 8, 0.1, 0.5, converged=False, hessian="exact"))
    return pd.DataFrame(rows)


def assessed() -> pd.DataFrame:
    return errors.assess(by_hand(), OF, lambda line: None)


def test_errors_are_of_what_converged_against_the_finest() -> None:
    said: list[str] = []
    table = errors.assess(by_hand(), OF, said.append)
    q1 = table[table["element"] == "Q1"]["error_displacement"]
    assert q1.tolist() == pytest.approx([0.5, 0.25, 0.125], rel=1e-3)
    assert table["error_energy"][0] == pytest.approx(0.5, rel=1e-3)
    assert np.isnan(table["error_displacement"].iloc[-1])  # that did not converge
    assert table["shift"].iloc[-2] == pytest.approx(1e-5, rel=1e-2)
    assert table["shift"][0] == 0
    told = {line.partition(":")[0]: line for line in said}
    assert "order 3.00" in told["energy"] and "Q2Q1 up to 16 cells" in told["energy"]
    assert "rejected" in told["volume"] and table["error_volume"].isna().all()
    assert "reaction" not in told


def test_without_three_meshes_there_is_no_error() -> None:
    table = by_hand().iloc[:5]
    found = errors.assess(table, OF, lambda line: None)
    assert found["error_displacement"].isna().all()
    assert list(advice.sentences(found)) == [
        "hand, nu = 0.3: the reference is not accurate enough, no recommendation"
    ]
    assert advice.advice(found).empty


# --- advice --------------------------------------------------------------------------------------


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
    assert five.startswith("hand, nu = 0.3, 20 % of displacement: use Q2Q1, 2 cells, adaptive")
    assert "0.08 s, 1.2 times the cheapest; Q1 takes 51 times that" in five
    assert "Q1 does not reach it: 16 cells, 51 times that, 12 %" in one
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
    assert chosen.values({"cells": 2, "nu": 0.2})["petsc.fieldsplit_u_pc_type"] == "hypre"


@pytest.mark.parametrize("text, number", [("1%", 0.01), ("5 %", 0.05), ("0.01", 0.01), (0.2, 0.2)])
def test_an_accuracy(text: Any, number: float) -> None:
    assert accuracy.fraction(text) == pytest.approx(number)


@pytest.mark.parametrize("text", ["1", "0", "-1%", "200%", "fine", "nan", ""])
def test_no_accuracy(text: str) -> None:
    with pytest.raises(BadInput, match=r"expected per cent or a fraction, e\.g\. 1% or 0\.01"):
        accuracy.fraction(text)


# --- the grid ------------------------------------------------------------------------------------


def plan(scene: str = "cook", **more: Any) -> Plan:
    own = scenes.load(scene)
    given: dict[str, Any] = {"nus": [0.3, 0.5], "elements": list(ELEMENTS)} | more
    return Plan(resolutions=resolutions(own, given["elements"], None), **given)


@pytest.mark.parametrize("scene", scenes.names())
def test_a_grid_of_every_scene(scene: str) -> None:
    tried = plan(scene)
    for nu in (0.3, 0.5):
        points = tried.points(scene, nu, {})
        elements = {point.values["element"] for point in points.values()}
        pressures = {name for name, e in ELEMENTS.items() if e.volume == "pressure"}
        assert elements == (pressures if nu == 0.5 else set(ELEMENTS))
        begun: set[str] = set()
        for name, point in points.items():
            assert point.after is None or point.after in begun  # the coarser one comes before
            begun.add(name)


def test_one_knob_at_a_time_or_all_of_them() -> None:
    tried = plan(elements=["Q1", "Q2Q1"], nus=[0.3])
    choices = tried.choices(0.3)
    assert len(set(choices)) == len(choices)
    grid = [
        choice for choice in choices if choice == tried.default(choice.element, choice.cells or 0)
    ]
    assert len(grid) == sum(len(cells) for cells in tried.resolutions.values())
    for element in ("Q1", "Q2Q1"):
        cells = middle_resolution(tried.resolutions[element])
        default = tried.default(element, cells)
        mine = [c for c in choices if c.element == element and c.cells == cells and c != default]
        for knob, values in knob_values(element).items():
            assert {getattr(c, knob) for c in [*mine, default]} == set(values)
        assert all(len(changed_knobs(choice, default)) == 1 for choice in mine)
    full = plan(elements=["Q1"], nus=[0.3], vary=["hessian", "solver"], full=True).choices(0.3)
    assert len(full) == len(tried.resolutions["Q1"]) * 4 * len(SOLVERS[False])


def test_forcing_is_turned_with_an_iterative_solver() -> None:
    turned = [c for c in Choice("Q1", 4, solver="direct").variations() if c.forcing != 0.1]
    assert {c.solver for c in turned} == {"cg+ssor"} and len(turned) == 3


@pytest.mark.parametrize(
    "wrong, told",
    [
        ({"element": "Q3"}, "element = 'Q3': expected one of"),
        ({"solver": "minres+gamg"}, r"solver of Q1 = 'minres\+gamg': expected one of"),
        ({"hessian": "none"}, "hessian = 'none': expected one of"),
        ({"forcing": 0}, "forcing = 0: expected a number > 0"),
        ({"tolerance": "small"}, "tolerance = small: expected a number > 0"),
    ],
)
def test_a_choice_that_there_is_not(wrong: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        Choice(**{"element": "Q1", "cells": 4, **wrong})


@pytest.mark.parametrize(
    "words, told",
    [
        ("cook --nu 0.5 --elements Q1", r"nu = 0\.5: none of Q1 can have it"),
        ("cook --elements Q9", "element = 'Q9': expected one of"),
        ("cook --vary speed", "knob = 'speed': expected one of"),
        ("cook --nu many", "--nu many: expected numbers"),
        ("cook --cells 8,4", "--cells 8,4: expected whole numbers from coarse to fine"),
        ("cook --cells 4 --meshes a.msh", "one or the other"),
        ("pull", "has no probe"),
        ("cook --solver magic", "solver = 'magic': expected one of"),
        ("cook --hessian magic", "hessian = 'magic': expected one of"),
        ("cook --timeout -1", "timeout = -1"),
    ],
)
def test_bad_input(
    words: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tradeoff", *words.split(), "--out", str(tmp_path / "o")]) == 2
    said = capsys.readouterr().err
    assert told.replace("\\", "") in said and said.count("\n") == 1


@pytest.mark.parametrize(
    "words, told",
    [
        ("pull --accuracy 1%", "there is no table for pull, only for"),
        ("cook --accuracy-table a.csv", "without --accuracy"),
        ("cook --accuracy 1% --accuracy-table none.csv", "cannot be read"),
        ("cook --accuracy 1% --accuracy-table setup.py", "has no column"),
    ],
)
def test_bad_accuracy(words: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", *words.split()]) == 2
    said = capsys.readouterr().err
    assert told in said and said.count("\n") == 1


# --- a whole study, on mesh files of one's own ---------------------------------------------------

SCENE = """
mesh = "box1.msh"
element = "Q1"
reactions = ["top"]
[material]
name = "stable_neo_hookean"
E = 1.0
nu = 0.3
[[hold]]
group = "bottom"
[[move]]
group = "top"
translate = [0.2, 0, 0.1]
[[probe]]
name = "middle"
point = [0.9, 0.4, 0.7]
"""
BOX = r"""
import gmsh, re, sys
gmsh.initialize(readConfigFiles=False)
gmsh.option.setNumber("General.Terminal", 0)
source = open(sys.argv[1]).read()
for n in (1, 2, 4):
    with open(f"{sys.argv[2]}/box.geo", "w") as geo:
        geo.write(re.sub(r"DefineConstant\[.*?\];", f"cells = {n}; tets = 0;", source, flags=re.S))
    gmsh.open(f"{sys.argv[2]}/box.geo")
    gmsh.model.mesh.generate(3)
    gmsh.write(f"{sys.argv[2]}/box{n}.msh")
"""


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("own")
    (folder / "box.toml").write_text(SCENE)
    words = [sys.executable, "-c", BOX, str(gmsh_input.source_path("cube")), str(folder)]
    subprocess.run(words, check=True, env=environment())
    return folder


def study(own: Path, said: list[str], **more: Any) -> pd.DataFrame:
    meshes = [str(own / f"box{n}.msh") for n in (1, 2, 4)]
    asked: dict[str, Any] = {"vary": [], "timeout": 60.0} | more
    return tradeoff(own / "box.toml", own / "out", meshes=meshes, report=said.append, **asked)


def test_a_study_of_ones_own_scene(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said: list[str] = []
    table = study(own, said, elements=["Q2Q1"], vary=["eigensolver"])
    assert len(table) == 4 and table["converged"].all() and table["cpu"].between(1e-4, 60).all()
    assert set(table["eigensolver"]) == {"cubic", "jacobi"} and table["default"].sum() == 3
    assert table["h"].tolist()[:3] == pytest.approx([1, 1 / 2, 1 / 4])
    assert any("energy: Q2Q1 up to" in line for line in said)

    said.clear()
    table = study(own, said, elements=["Q1", "Q2Q1"])
    assert said[0] == "3 of 6 points are there already"
    assert len(table) == 7
    q1 = table[table["element"] == "Q1"]
    assert q1["error_energy"].iloc[0] > q1["error_energy"].iloc[2] > 0
    assert (table["floor_energy"] > 0).all()
    for name in ("tradeoff.csv", "tradeoff.png", "advice.csv", "advice.md", "tradeoff.json"):
        assert (own / "out" / name).stat().st_size > 100

    said.clear()
    again = study(own, said, elements=["Q1", "Q2Q1"])
    assert said[0] == "6 of 6 points are there already"
    pd.testing.assert_frame_equal(again, table)
    with pytest.raises(BadInput, match=r"holds tradeoff\.csv of other values"):
        study(own, said, overrides={"E": 2.0})

    with (own / "out" / "advice.csv").open() as file:
        best = list(csv.DictReader(file))[-1]
    asked = f"{1.01 * float(best['error'])}"
    words = ["run", str(own / "box.toml"), "--accuracy", asked, "--out", str(own / "run")]
    assert main([*words, "--accuracy-table", str(own / "out" / "advice.csv")]) == 0
    assert f"accuracy: {best['element']}, {best['mesh']}" in capsys.readouterr().out
    record = json.loads((own / "run" / "run.json").read_text())
    assert record["accuracy"]["element"] == record["element"] == best["element"]
    assert record["accuracy"]["error"] == pytest.approx(float(best["error"]))


def test_what_runs_out_of_time_is_a_row(own: Path, tmp_path: Path) -> None:
    meshes = [str(own / f"box{n}.msh") for n in (1, 2, 4)]
    said: list[str] = []
    table = tradeoff(
        own / "box.toml", tmp_path, meshes=meshes, elements=["Q1"], vary=[], timeout=0.05,
        report=said.append,
    )  # fmt: skip
    assert table["status"][0] == "given up after 0.05 s"
    assert table["status"][1].startswith("not tried: ") and not table["converged"].any()
    with pytest.raises(BadInput, match="holds no error"):
        plots.main([tmp_path / "tradeoff.csv"])
    assert advice.advice(table).empty


def test_a_scene_has_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At a lower nu than any that was measured, the row of the lowest."""
    words = ["run", "cook", "--nu", "0.2", "--accuracy", "5%", "--out", str(tmp_path)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert said.startswith("accuracy: ") and "at nu = 0.3 (cook.csv)" in said
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["accuracy"]["error"] <= 0.05 and record["accuracy"]["asked"] == 0.05
    assert record["material"]["nu"] == 0.2 and record["hessian"] == record["accuracy"]["hessian"]


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


# --- the page's tables ---------------------------------------------------------------------------


def test_a_page_is_filled_from_its_tables() -> None:
    table = assessed()
    kinds = {kind: tradeoff_tables.TABLES[kind](table) for kind in tradeoff_tables.TABLES}
    assert "| Q1 | 8 | 512 | 25 % |" in kinds["locking"]
    assert "| Q1 | 5 % | never |\n" in kinds["price"]
    assert "| Q2Q1 | 5 % | 0.08 (2) |\n" in kinds["price"]
    assert "| Q2Q1 | 8 | 1 |" in kinds["iterations"]
    assert "| 0.3 | Q2Q1 | 4 | clamp | 1 | 1 | x 1.6 | 1e-05 |" in kinds["knobs"]
    assert "| 0.3 | Q2Q1 | 4 |  | 1, x 1.6 |  | 1, x 1 |" in kinds["filters"]
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
