"""A study of accuracy against cost: its grid, wrong input, and whole studies."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from fem_snh import scenes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.mesh import gmsh_input
from fem_snh.studies.processes import environment
from fem_snh.studies.tradeoff import advice
from fem_snh.studies.tradeoff.grid import (
    Plan,
    changed_knobs,
    middle_resolution,
    point_name,
    resolutions,
)
from fem_snh.studies.tradeoff.knobs import SOLVERS, Choice, knob_values
from fem_snh.studies.tradeoff.study import tradeoff
from fem_snh.viewing import plots


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
    assert len(full) == len(tried.resolutions["Q1"]) * 5 * len(SOLVERS["pointwise"])


def test_values_that_differ_in_the_seventh_digit_have_folders_of_their_own() -> None:
    close = (0.4999999, 0.49999991, 0.5)
    choices = [Choice("P2P1", 4, tolerance=t) for t in (1.0000001e-7, 1.0000002e-7, 1e-7)]
    names = {point_name(nu, choice) for nu in close for choice in choices}
    assert len(names) == 9 and point_name(0.5, choices[-1]).startswith("nu=0.5__P2P1__4__")


def test_forcing_is_turned_with_an_iterative_solver() -> None:
    turned = [c for c in Choice("Q1", 4, solver="direct").variations() if c.forcing != 0.1]
    assert {c.solver for c in turned} == {"cg+ssor"} and len(turned) == 3


def test_the_default_names_neither_hessian_nor_solver() -> None:
    """So that the program chooses both, and the condensation of cell pressures."""
    free = Choice("Q1P0", 4).values()
    assert not {"hessian", "globalization", "static_condensation"} & set(free)
    assert not any(key.startswith(("petsc.ksp", "petsc.snes_linear")) for key in free)
    mixed = Choice("Q1P0", 4, solver="mixed+direct").values()
    assert mixed["static_condensation"] is False
    assert mixed["petsc.snes_linear_solver"] == "direct"
    assert Choice("Q1P0", 4, solver="cg+jacobi").values()["static_condensation"] is True
    assert Choice("Q2Q1", 4, hessian="clamp").values()["globalization"] == "linesearch"


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"element": "Q3"}, "element = 'Q3': expected one of"),
        ({"solver": "minres+gamg"}, r"solver of Q1 = 'minres\+gamg': expected one of"),
        ({"hessian": "none"}, "hessian = 'none': expected one of"),
        ({"forcing": 0}, "forcing = 0: expected a number > 0"),
        ({"tolerance": "small"}, "tolerance = small: expected a number > 0"),
    ],
)
def test_a_choice_that_there_is_not(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        Choice(**{"element": "Q1", "cells": 4, **wrong})


@pytest.mark.parametrize(
    "words, message",
    [
        ("cook --nu 0.5 --elements Q1", r"nu = 0\.5: none of Q1 can have it"),
        ("cook --elements Q9", "element = 'Q9': expected one of"),
        ("cook --vary speed", "vary = 'speed': expected one of"),
        ("cook --nu many", "--nu many: expected numbers"),
        ("cook --cells 8,4", "--cells 8,4: expected whole numbers from coarse to fine"),
        ("cook --cells 4 --meshes a.msh", "--cells and --meshes: expected one of the two"),
        ("pull", "has no probe"),
        ("cook --solver magic", "solver = 'magic': expected one of automatic, cg+ssor, "),
        ("cook --hessian magic", "hessian = 'magic': expected one of"),
        ("cook --timeout -1", "timeout = -1"),
        ("cook --nu 0.3 --set material={nu=0.4}", "nu and material: expected one of them"),
    ],
)
def test_bad_input(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tradeoff", *words.split(), "--out", str(tmp_path / "o")]) == 2
    output = capsys.readouterr().err
    assert message.replace("\\", "") in output and output.count("\n") == 1


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


def study(own: Path, lines: list[str], **more: Any) -> pd.DataFrame:
    meshes = [str(own / f"box{n}.msh") for n in (1, 2, 4)]
    asked: dict[str, Any] = {"vary": [], "timeout": 60.0} | more
    return tradeoff(own / "box.toml", own / "out", meshes=meshes, report=lines.append, **asked)


def test_a_study_without_a_reference_says_so_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It said so after all points, and named a picture that it had not drawn."""
    words = "tradeoff twist --cells 1,2 --elements Q1,Q2Q1 --vary none --steps 1 --set angle=0.2"
    assert main([*words.split(), "--out", str(tmp_path / "o")]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert not any("error:" in line for line in lines)  # of the picture
    first, point = (
        next(i for i, s in enumerate(lines) if s.startswith(t)) for t in ("no ref", "[")
    )
    assert first < point and "on three meshes" in lines[first]
    assert lines[-2] == "twist, nu = 0.49: no reference that is accurate enough, no recommendation"
    assert lines[-1].endswith("o: tradeoff.csv, advice.csv, advice.md")


def test_a_study_of_ones_own_scene(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines: list[str] = []
    table = study(own, lines, elements=["Q2Q1"], vary=["tolerance"])
    assert len(table) == 6 and table["converged"].all() and table["cpu"].between(1e-4, 60).all()
    assert set(table["tolerance"]) == {1e-3, 1e-5, 1e-7, 1e-9} and table["default"].sum() == 3
    assert table["h"].tolist()[:3] == pytest.approx([1, 1 / 2, 1 / 4])
    assert any("energy: Q2Q1 up to" in line for line in lines)

    lines.clear()
    table = study(own, lines, elements=["Q1", "Q2Q1"])
    assert lines[0] == "3 of 6 points are there already"
    assert len(table) == 9
    q1 = table[table["element"] == "Q1"]
    assert q1["error_energy"].iloc[0] > q1["error_energy"].iloc[2] > 0
    assert (table["floor_energy"] > 0).all()
    for name in ("tradeoff.csv", "tradeoff.png", "advice.csv", "advice.md", "tradeoff.json"):
        assert (own / "out" / name).stat().st_size > 100

    lines.clear()
    again = study(own, lines, elements=["Q1", "Q2Q1"])
    assert lines[0] == "6 of 6 points are there already"
    pd.testing.assert_frame_equal(again, table)
    with pytest.raises(BadInput, match=r"holds tradeoff\.csv of other values"):
        study(own, lines, overrides={"E": 2.0})


def test_what_runs_out_of_time_is_a_row(own: Path, tmp_path: Path) -> None:
    meshes = [str(own / f"box{n}.msh") for n in (1, 2, 4)]
    lines: list[str] = []
    table = tradeoff(
        own / "box.toml", tmp_path, meshes=meshes, elements=["Q1"], vary=[], timeout=0.05,
        report=lines.append,
    )  # fmt: skip
    assert table["status"][0] == "given up after 0.05 s"
    assert table["status"][1].startswith("not tried: ") and not table["converged"].any()
    with pytest.raises(BadInput, match="holds no error"):
        plots.main([tmp_path / "tradeoff.csv"])
    assert advice.advice(table).empty


GEL = """
from sympy import log
def gel(I_C, J, mu, lam):
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2
"""


def test_a_study_with_a_material_of_ones_own(own: Path, tmp_path: Path) -> None:
    (own / "gel.py").write_text(GEL)
    table = tradeoff(
        own / "box.toml", tmp_path, meshes=[str(own / f"box{n}.msh") for n in (1, 2)],
        elements=["Q1"], vary=[], timeout=60.0, overrides={"material": f"{own / 'gel.py'}:gel"},
        report=lambda line: None,
    )  # fmt: skip
    assert len(table) == 2 and table["converged"].all() and table["newton"].max() > 0
    records = [json.loads(path.read_text()) for path in tmp_path.rglob("run.json")]
    assert records and all(r["material"]["name"].endswith("gel.py:gel") for r in records)


def test_poissons_ratio_of_a_table(own: Path, tmp_path: Path) -> None:
    """It was said to be given twice, as each point has one."""
    table = tradeoff(
        own / "box.toml", tmp_path, meshes=[str(own / f"box{n}.msh") for n in (1, 2)],
        elements=["Q1"], vary=[], timeout=60.0, overrides={"material": {"nu": 0.35}},
        report=lambda line: None,
    )  # fmt: skip
    assert len(table) == 2 and table["converged"].all() and (table["nu"] == 0.35).all()
    records = [json.loads(path.read_text()) for path in tmp_path.rglob("run.json")]
    assert records and all(r["material"]["nu"] == 0.35 for r in records)


def test_a_study_over_nu_keeps_the_equation(own: Path, tmp_path: Path) -> None:
    """Eq. 14 below nu = 0.4, and eq. 13 above, differ by 10 to 17 %: errors are of one equation."""
    said: list[str] = []
    tradeoff(
        own / "box.toml", tmp_path, nus=[0.39, 0.4], meshes=[str(own / "box1.msh")],
        elements=["Q1"], vary=[], timeout=60.0, overrides={"material": {"E": 2.0}},
        report=said.append,
    )  # fmt: skip
    materials = [json.loads(path.read_text())["material"] for path in tmp_path.rglob("run.json")]
    assert {m["nu"] for m in materials} == {0.39, 0.4} and {m["E"] for m in materials} == {2.0}
    assert all(m["equation"].startswith("eq. 13") for m in materials)
    assert any(line.startswith("material.barrier = false at all nu") for line in said)
