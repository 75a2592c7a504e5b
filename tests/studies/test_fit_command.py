"""The command fit: files that it writes, what it prints, mistakes in one line."""

from __future__ import annotations

import csv
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from fem_snh import cli, materials
from fem_snh.studies.fit.data import TESTS


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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
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


def test_help_names_all_tests(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["fit", "--help"])
    words = capsys.readouterr().out.split("# test = ")[1].splitlines()[0].replace(",", "").split()
    assert [word for word in words if word != "or"] == list(TESTS)


def test_one_point_determines_a_modulus_without_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was called "not shown by the data", which the help says of what has no influence."""
    path = tmp_path / "d.csv"
    path.write_text("# test = uniaxial\nstretch, stress\n1.5, 1\n")
    assert cli.main(["fit", "neo_hookean", str(path), "--out", str(tmp_path / "fit")]) == 0
    printed = capsys.readouterr().out
    assert f"{3 / (1.5 - 1.5**-2):.6g}" in printed
    assert "needs more points than parameters" in printed


def test_a_stable_range_under_dead_loads_is_printed_where_it_is_smaller(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Mooney-Rivlin with C1 = 3 C2 > 0: Kearsley's equal stretch is 1.8297."""
    path = tmp_path / "d.csv"
    rows = [(s, 2 * (s - s**-5) * (0.15 + 0.05 * s**2)) for s in (0.8, 1.2, 1.6, 2.0, 2.4)]
    path.write_text(
        "# test = equibiaxial\nstretch, stress\n" + "".join(f"{s}, {P}\n" for s, P in rows)
    )
    out = tmp_path / "fit"
    assert cli.main(["fit", "mooney_rivlin", str(path), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "equibiaxial: all of it; under dead loads 0.4 to 1.83\n" in printed
    assert "planar: all of it\n" in printed
    record = json.loads((out / "fit.json").read_text())
    assert record["stable"]["equibiaxial"] == record["searched"]
    assert record["stable_under_dead_loads"]["equibiaxial"][1] == pytest.approx(1.8297, abs=1e-4)


def test_biaxial(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Data of Jones & Treloar; a biaxial test without a second stretch is one line."""
    words = ["fit", "mooney_rivlin", "jones_treloar", "--out", str(tmp_path)]
    assert cli.main([*words, "--range", "0.9,1.5"]) == 0
    assert "stable (Drucker) at all data: yes" in capsys.readouterr().out
    assert cli.main(words) == 0
    assert "stable (Drucker) at all data: yes" in capsys.readouterr().out
    record = json.loads((tmp_path / "fit.json").read_text())
    assert [t["measure"] for t in record["tests"]] == ["stress", "stress_difference"]
    assert record["stable_at_data"] is True
    path = tmp_path / "d.csv"
    path.write_text("# test = biaxial\nstretch, stress\n1.5, 1\n")
    assert cli.main(["fit", "ogden", str(path)]) == 2
    error = capsys.readouterr().err
    assert "expected a column stretch_2, or test = equibiaxial" in error
    assert error.count("\n") == 1


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
        (["--all", "treloar", "--report"], "expected without --all"),
        (["stvk", "treloar"], "has no volume term"),
    ],
)
def test_mistakes(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["fit", *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
