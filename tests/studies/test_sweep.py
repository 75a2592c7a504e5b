"""Sweeps: points, rows that survive an interrupt, and processes that end with it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import fem_snh
from fem_snh.cli import main
from fem_snh.cli.run import comma_list
from fem_snh.studies.points import MEASURED, REQUESTED, largest_error
from fem_snh.studies.sweep import sweep
from fem_snh.studies.tasks import environment, program

pytestmark = pytest.mark.one_debian

TINY: dict[str, Any] = {"cells": 2, "steps": 1, "angle": 0.2}


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("0.3,0.45", [0.3, 0.45]), ("a, b", ["a", "b"]), ("true", [True]),
        ("[1,0,0],[0,1,0]", [[1, 0, 0], [0, 1, 0]]), ('"a,b","c"', ["a,b", "c"]),
    ],
)  # fmt: skip
def test_comma_list(text: str, values: list[Any]) -> None:
    assert comma_list("key", text) == values


def test_a_table_is_made_of_the_points_that_have_ended(tmp_path: Path) -> None:
    """Whatever has become of the file."""
    values = TINY | {"nu": [0.3, 0.4]}
    table = sweep("twist", tmp_path, values)
    whole = (tmp_path / "sweep.csv").read_text()
    for text in (whole[:-20], "a,b\n1,2\n", "point,nu\n1,2,3\n", "\0\xff\n\0\n", None):
        (tmp_path / "sweep.csv").unlink() if text is None else (
            (tmp_path / "sweep.csv").write_text(text)
        )
        pd.testing.assert_frame_equal(sweep("twist", tmp_path, values), table)
        assert (tmp_path / "sweep.csv").read_text() == whole
    (tmp_path / "nu=0.4" / "end.json").write_text("{")  # as if it were killed
    again = sweep("twist", tmp_path, values)
    assert again["converged"].all() and again["point"].tolist() == table["point"].tolist()


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pd.DataFrame]:
    out = tmp_path_factory.mktemp("sweep")
    axes = TINY | {"nu": [0.3, 0.45], "material": ["stable_neo_hookean", "neo_hookean"]}
    return out, sweep("twist", out, axes, jobs=2)


def test_sweep_is_a_tidy_table_and_a_picture(done: tuple[Path, pd.DataFrame]) -> None:
    out, table = done
    results = [f"top.force.{a}" for a in "xyz"]
    results += [f"{probe}.{a}" for probe in ("side", "edge", "inside") for a in "xyz"]
    variant = ["material.barrier"]
    expected = ["point", *REQUESTED, "angle", *variant, "ranks", *MEASURED, *results]
    assert list(table.columns) == expected
    assert len(table) == 4 and table["converged"].all() and (table["newton"] > 0).all()
    assert set(table["nu"]) == {0.3, 0.45} and table["num_cells"].eq(8).all()
    assert not table.drop(columns=variant).isna().any().any()
    assert (out / "sweep.png").stat().st_size > 1000
    for at, (name, energy) in enumerate(zip(table["point"], table["energy"], strict=True)):
        record = json.loads((out / name / "run.json").read_text())
        assert (
            record["steps"][-1]["energy"] == pytest.approx(energy, rel=1e-12)
            and record["steps"][-1]["probes"]["edge"][1]
            == pytest.approx(table["edge.y"][at], rel=1e-12)
            and (out / name / "log.txt").exists()
        )


def test_a_sweep_over_nu_keeps_the_equation(tmp_path: Path) -> None:
    """A sweep with eq. 14 below 0.4, and eq. 13 above, has a jump there of 10 to 17 %."""
    said: list[str] = []
    small = {"cells": 2, "steps": 1}
    table = sweep("pull", tmp_path, small | {"nu": [0.399, 0.4]}, report=said.append)
    one = fem_snh.run("pull", nu=0.399, progress=False, **small, **{"material.barrier": False})
    forces = table["right.force.x"]
    assert forces[0] == pytest.approx(one.steps[-1]["reactions"]["right"][0], rel=1e-8)
    assert forces[0] == pytest.approx(forces[1], rel=3e-3)
    assert table["material.barrier"].tolist() == [False] * 2
    (line,) = [line for line in said if "barrier" in line]
    assert line.startswith("material.barrier = false at all nu: stable_neo_hookean has eq. 13 of")
    chosen = small | {"nu": [0.39, 0.4], "material.barrier": True}
    table = sweep("pull", tmp_path, chosen, overwrite=True, report=said.append)
    assert table["material.barrier"].tolist() == [True] * 2


def test_rows_have_seconds_and_errors(tmp_path: Path) -> None:
    """The errors are those of the run; the seconds are without compilation and estimate."""
    words = "sweep twist --cells 2 --steps 1 --element Q1,Q1P0 --error"
    more = ["--set", "angle=0.2", "--set", "petsc.snes_scaled_tol=1e-3,1e-7"]
    assert main([*words.split(), *more, "--out", str(tmp_path)]) == 0
    table = pd.read_csv(tmp_path / "sweep.csv")
    assert len(table) == 4 and table["error"].between(1e-4, 20).all()
    for _, row in table.iterrows():
        record = json.loads((tmp_path / row["point"] / "run.json").read_text())
        seconds, goal = record["seconds"], record["goals"]["edge.y"]
        spent = seconds["total"] - seconds["jit"] - seconds["estimate"]
        assert row["seconds"] == pytest.approx(spent) and spent > 0
        assert row["edge.y.error"] == pytest.approx(goal["error"])
        assert row["error"] == pytest.approx(largest_error(record))
    assert (tmp_path / "sweep.png").exists()


def test_the_largest_error_is_relative_to_a_vector() -> None:
    """A component that is small beside the others does not count as if it were the whole."""
    goals = {
        "tip.x": {"value": 0.001, "error": 0.002, "relative": 2.0},
        "tip.y": {"value": -2.0, "error": 0.1, "relative": 0.05},
        "top.force.z": {"value": 1e-18, "error": 1e-17, "relative": None, "bound": 1e-9},
        "volume": {"value": 1.0, "error": 0.0, "relative": 0.0, "bound": 0.01},
        "energy": {"value": 3.0, "error": None, "relative": None, "corrected": None},
    }
    assert largest_error({"goals": goals}) == 0.05
    goals["volume"]["bound"] = 0.2
    assert largest_error({"goals": goals}) == 0.2
    assert largest_error({}) is None


def test_failed_points_are_rows_and_can_be_retried(tmp_path: Path) -> None:
    first = sweep("twist", tmp_path, TINY, timeout=0.05)
    assert list(first["status"]) == ["given up after 0.05 s"]
    assert not first["converged"].any() and first["dofs"].isna().all()
    passed_over = sweep("twist", tmp_path, TINY)
    assert not passed_over["converged"].any()
    again = sweep("twist", tmp_path, TINY, retry=True)
    assert again["converged"].all() and len(again) == 1


def test_interrupt_leaves_a_readable_table_and_no_process(tmp_path: Path) -> None:
    words = ["sweep", "twist", "--cells", "2,3", "--steps", "1,500", "--out", str(tmp_path)]
    parent = subprocess.Popen(
        [*program(1), *words, "--set", "angle=0.2"],
        env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    late = time.monotonic() + 60
    while not (tmp_path / "cells=2__steps=500" / "log.txt").exists():
        assert time.monotonic() < late and parent.poll() is None
        time.sleep(0.05)
    parent.send_signal(signal.SIGINT)
    _, output = parent.communicate(timeout=30)
    assert parent.returncode == 130 and output.count("\n") == 1 and "interrupted" in output
    assert list(pd.read_csv(tmp_path / "sweep.csv")["point"]) == ["cells=2__steps=1"]
    assert not _mentioning(str(tmp_path))


def _mentioning(text: str) -> list[int]:
    """The other processes with ``text`` on their command line."""
    found = []
    for line in Path("/proc").glob("[0-9]*/cmdline"):
        pid = int(line.parent.name)
        try:
            if pid != os.getpid() and text in line.read_text(errors="replace"):
                found.append(pid)
        except OSError:
            continue
    return found


def test_a_point_that_crashes_is_a_row(tmp_path: Path) -> None:
    """A scene that kills its process is a row with the signal; the points after it are solved."""
    (tmp_path / "scene.py").write_text(
        "import os\nfrom fem_snh import scenes\n"
        "def fragile(crash: float = 0.0, cells: int = 2) -> scenes.Scene:\n"
        f"    if crash == 2.0 and os.getpid() != {os.getpid()}:\n"
        "        os.kill(os.getpid(), 9)\n"
        "    return scenes.load('twist', cells=cells, steps=1, angle=0.2)\n"
    )
    out = tmp_path / "out"
    scene = f"{tmp_path / 'scene.py'}:fragile"
    table = sweep(scene, out, {"crash": [1.0, 2.0, 3.0]})
    assert table["converged"].tolist() == [True, False, True]
    assert "ended by signal 9" in table["status"][1]
