"""The command fit: files that it writes, what it prints, mistakes in one line."""

from __future__ import annotations

import csv
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from fem_snh import cli, materials


@pytest.mark.one_debian
def test_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """P = mu (x - x^-2) of two files in MPa and Pa; the table is a material of a scene."""
    x = np.array([0.7, 1.2, 1.6])
    for name, unit, size in (("a", "MPa", 1e6), ("b", "Pa", 1.0)):
        rows = "\n".join(f"{s}, {0.4e6 / size * (s - s**-2)!r}" for s in x.tolist())
        text = f"# test = uniaxial\nstretch, stress [{unit}]\n{rows}\n"
        (tmp_path / f"{name}.csv").write_text(text)
    files = [str(tmp_path / f"{name}.csv") for name in "ab"]
    out = tmp_path / "out"
    words = ["fit", "stable_neo_hookean", *files, "--weights", "1,2", "--out", str(out)]
    assert cli.main(words) == 0
    printed = capsys.readouterr().out
    assert "[material]" in printed
    assert "planar: all of it" in printed
    table = tomllib.loads((out / "material.toml").read_text())["material"]
    assert table["E"] == pytest.approx(1.2e6, rel=1e-9)
    assert table["nu"] == 0.5
    assert "E = 1200000.0  # Pa\n" in (out / "material.toml").read_text()
    assert any("│ E " in line and "│ Pa " in line for line in printed.splitlines())
    record = json.loads((out / "fit.json").read_text())
    assert record["r_squared"] == pytest.approx(1)
    assert record["units"] == {"E": "Pa"}
    assert [t["points"] for t in record["tests"]] == [3, 3]
    assert (out / "fit.png").read_bytes()[:4] == b"\x89PNG"


def test_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(materials, "names", lambda: ["hencky", "neo_hookean", "seth_hill"])
    assert cli.main(["fit", "--all", "treloar", "--out", str(tmp_path)]) == 0
    rows = list(csv.DictReader((tmp_path / "ranking.csv").open()))
    assert [(row["rank"], row["material"]) for row in rows] == [
        ("1", "neo_hookean"),
        ("2", "hencky"),
    ]
    assert rows[1]["stable_at_data"] == "True"  # Hencky's, at all stretches
    assert "not fitted: material 'seth_hill'" in capsys.readouterr().out
    assert (tmp_path / "fit.png").read_bytes()[:4] == b"\x89PNG"


def test_options(tmp_path: Path) -> None:
    """Columns, a held parameter and bounds; 0.25 is the bound of gamma."""
    path = tmp_path / "d.txt"
    path.write_text("1 0.1 0.11\n2 0.2 0.25\n3 0.3 0.4\n4 0.4 0.6\n")
    words = ["fit", "stable_fung", str(path), "--columns", "time,strain,stress", "--test", "planar",
             "--set", "mu_1=5", "--bounds", "gamma=0,0.25", "--nu", "0.4", "--range", "0.8,2",
             "--relative", "--out", str(tmp_path)]  # fmt: skip
    assert cli.main(words) == 0
    record = json.loads((tmp_path / "fit.json").read_text())
    assert record["material"]["mu_1"] == 5
    assert record["material"]["nu"] == 0.4
    assert 0 <= record["parameters"]["gamma"] <= 0.25
    assert record["searched"] == [0.8, 2]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "missing NAME"),
        (["ogden"], "no test data"),
        (["ogden", "treloa.csv"], "no such file"),
        (["odgen", "treloar"], "did you mean 'ogden'?"),
        (["ogden", "treloar", "--range", "1"], "--range 1: expected two numbers"),
        (["ogden", "treloar", "--bounds", "weights=a,b"], "expected two numbers"),
        (["ogden", "treloar", "--set", "nu=0.3"], "held = 'nu': expected a shape parameter"),
        (["ogden", "treloar", "--nu", "soft"], "nu = 'soft': expected a number"),
        (["ogden", "treloar", "--weights", "a"], "weights = 'a': expected a number"),
        (["ogden", "treloar", "--weights", "1" + 400 * "0"], "expected a number > 0"),
        (["ogden", "treloar", "--weights", "1" + 5000 * "0"], "expected a number > 0"),
        (["ogden", "treloar", "--range", "0.5,1" + 400 * "0"], "expected a finite number"),
        (["stvk", "treloar"], "has no volume term"),
    ],
)
def test_mistakes(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["fit", *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
