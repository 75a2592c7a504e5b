"""Sweeps: points, rows that survive anything, and processes that end when they should."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from fem_snh import scenes
from fem_snh.cli.campaign import axis
from fem_snh.errors import BadInput
from fem_snh.studies.batch import Batch
from fem_snh.studies.point import Limits, Point
from fem_snh.studies.processes import Child, environment, program
from fem_snh.studies.scene_points import ScenePoint, run_arguments
from fem_snh.studies.sweep import combinations, sweep
from fem_snh.studies.table import MEASURED, REQUESTED, Table

TINY: dict[str, Any] = {"cells": 2, "steps": 1, "angle": 0.2}


# --- points --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("0.3,0.45", [0.3, 0.45]), ("a, b", ["a", "b"]), ("true", [True]),
        ("[1,0,0],[0,1,0]", [[1, 0, 0], [0, 1, 0]]), ('"a,b",c', ["a,b", "c"]),
    ],
)  # fmt: skip
def test_axis(text: str, values: list[Any]) -> None:
    assert axis("key", text) == values


def test_points_are_named_by_what_differs() -> None:
    points = combinations({"nu": [0.3, 0.49], "material": ["a", "b"], "cells": [2]})
    assert len(points) == 4
    assert points["nu=0.3__material=b"] == {"nu": 0.3, "material": "b", "cells": 2}
    assert list(combinations({"cells": [2]})) == ["point"]


def test_a_point_is_a_command_line() -> None:
    words = run_arguments(
        "twist", Path("d"), {"nu": -0.1, "material": "a"}, {"ksp_rtol": 1, "v": None}
    )
    assert words[:2] == ["run", "twist"] and "--set=nu=-0.1" in words
    assert words[words.index("--") :] == ["--", "-ksp_rtol", "1", "-v"]


# --- the table -----------------------------------------------------------------------------------


def test_a_row_cut_off_is_forgotten(tmp_path: Path) -> None:
    table = Table(tmp_path / "t.csv", ["point", "status"])
    table.append({"point": "a", "status": 'with, "comma"', "other": 1})
    table.append({"point": "b"})
    whole = table.path.read_text()
    table.path.write_text(whole + "c,half of a li")
    assert [row["point"] for row in table.rows()] == ["a", "b"]
    assert Table(table.path, table.columns).path.read_text() == whole
    assert table.rows()[0]["status"] == 'with, "comma"'
    table.drop(["a"])
    assert [row["point"] for row in table.rows()] == ["b"]


# --- whole sweeps --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pd.DataFrame]:
    out = tmp_path_factory.mktemp("sweep")
    axes = TINY | {"nu": [0.3, 0.45], "material": ["stable_neo_hookean", "neo_hookean"]}
    return out, sweep("twist", out, axes, jobs=2)


def test_sweep_is_a_tidy_table_and_a_picture(done: tuple[Path, pd.DataFrame]) -> None:
    out, table = done
    assert list(table.columns) == ["point", *REQUESTED, "angle", "ranks", *MEASURED]
    assert len(table) == 4 and table["converged"].all() and (table["newton"] > 0).all()
    assert set(table["nu"]) == {0.3, 0.45} and table["num_cells"].eq(8).all()
    assert not table.isna().any().any()
    assert (out / "sweep.png").stat().st_size > 1000
    for name, energy in zip(table["point"], table["energy"], strict=True):
        record = json.loads((out / name / "run.json").read_text())
        assert (
            record["steps"][-1]["energy"] == pytest.approx(energy, rel=1e-12)
            and (out / name / "log.txt").exists()
        )


def test_a_finished_sweep_runs_nothing(done: tuple[Path, pd.DataFrame]) -> None:
    out, table = done
    said: list[str] = []
    definition = json.loads((out / "sweep.json").read_text())
    again = sweep("twist", out, definition["axes"], report=said.append)
    pd.testing.assert_frame_equal(again, table)
    assert said[0] == "4 of 4 points are there already"


def test_another_sweep_needs_another_folder(done: tuple[Path, pd.DataFrame]) -> None:
    with pytest.raises(BadInput, match=r"holds sweep.csv of other axes.*--overwrite"):
        sweep("twist", done[0], TINY)


def test_failed_points_are_rows_and_can_be_retried(tmp_path: Path) -> None:
    first = sweep("twist", tmp_path, TINY, timeout=0.05)
    assert list(first["status"]) == ["given up after 0.05 s"]
    assert not first["converged"].any() and first["dofs"].isna().all()
    passed_over = sweep("twist", tmp_path, TINY)
    assert not passed_over["converged"].any()
    again = sweep("twist", tmp_path, TINY, retry=True)
    assert again["converged"].all() and len(again) == 1


def test_overwrite_begins_anew(tmp_path: Path) -> None:
    sweep("twist", tmp_path, TINY | {"nu": [0.3, 0.4]}, timeout=0.05)
    table = sweep("twist", tmp_path, TINY | {"nu": 0.3}, overwrite=True)
    assert list(table["point"]) == ["point"] and table["converged"].all()
    assert not (tmp_path / "nu=0.3").exists()


def test_a_point_that_does_not_converge_says_so(tmp_path: Path) -> None:
    table = sweep("twist", tmp_path, TINY, petsc={"snes_max_it": 0}, ranks=2)
    assert not table["converged"][0] and table["status"][0] and table["ranks"][0] == 2


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
    _, said = parent.communicate(timeout=30)
    assert parent.returncode == 130 and said.count("\n") == 1 and "interrupted" in said
    assert list(pd.read_csv(tmp_path / "sweep.csv")["point"]) == ["cells=2__steps=1"]
    assert not _mentioning(str(tmp_path))


# --- processes -----------------------------------------------------------------------------------


def test_a_child_ends_with_all_its_ranks(tmp_path: Path) -> None:
    stubborn = "import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(300)"
    mpirun = program(2)[:3]
    child = Child([*mpirun, sys.executable, "-c", stubborn], tmp_path / "log.txt", timeout=1)
    while child.poll() is None:
        time.sleep(0.1)
    assert child.limit_reached == "given up after 1 s" and not child.processes()


def test_children_have_a_folder_for_files_each(tmp_path: Path) -> None:
    """Two of Open MPI's jobs in one: that which ends removes what that which begins is to use."""
    tell = "import tempfile; print(tempfile.gettempdir())"
    logs = [tmp_path / "one.txt", tmp_path / "two.txt"]
    for child in [Child([sys.executable, "-c", tell], log) for log in logs]:
        while (code := child.poll()) is None:
            time.sleep(0.01)
        assert code == 0
    folders = {log.read_text().strip() for log in logs}
    assert len(folders) == 2 and not any(Path(folder).exists() for folder in folders)


def test_memory_is_counted_over_all_ranks(tmp_path: Path) -> None:
    """Neither rank alone is above the limit."""
    hungry = "import time; kept = b'x' * (300 << 20); time.sleep(300)"
    words = [*program(2)[:3], sys.executable, "-c", hungry]
    child = Child(words, tmp_path / "log.txt", timeout=30, memory=0.5)
    while child.poll() is None:
        time.sleep(0.05)
    assert child.limit_reached == "given up above 0.5 GiB" and not child.processes()
    alone = Child([sys.executable, "-c", hungry], tmp_path / "log.txt", timeout=1.5, memory=0.5)
    while alone.poll() is None:
        time.sleep(0.05)
    assert alone.limit_reached == "given up after 1.5 s"


def test_what_is_hopeless_is_not_tried(tmp_path: Path) -> None:
    """A finer mesh than one that was given up, or than one that took too long by itself."""
    scene = scenes.load("twist", **TINY)
    said: list[str] = []
    batch = Batch(
        tmp_path, "study", {}, ["point", *REQUESTED, *MEASURED], Limits(2, timeout=0.05),
        report=said.append,
    )  # fmt: skip
    points = {
        "a": ScenePoint("twist", TINY, scene),
        "b": ScenePoint("twist", TINY, scene, after="a"),
        "c": ScenePoint("twist", TINY, scene, after="b"),
        "d": ScenePoint("twist", TINY, scene, timeout=60.0),
        "e": ScenePoint("twist", TINY, scene, timeout=60.0, after="d", growth=1e6),
    }
    batch.run(points)
    status = {row["point"]: row["status"] for row in batch.table.rows()}
    assert status.pop("a") == "given up after 0.05 s"
    assert status.pop("b") == status.pop("c") == "not tried: 2 cells were given up after 0.05 s"
    assert status == {"d": "converged", "e": "not tried: would take more than 60 s"}
    assert len(said) == 5 and not (tmp_path / "b").exists()


class Echo(Point):
    """A point that is no run of a scene: a module of Python's own, and what it says."""

    module = "calendar"
    parallel = False

    def arguments(self, folder: Path) -> list[str]:
        return ["2018"]

    def requested(self) -> Mapping[str, Any]:
        return {"scene": "none"}

    def measured(self, record: Mapping[str, Any], log: Path, code: int) -> Mapping[str, Any]:
        said = log.read_text().split()
        return {"converged": code == 0 and not record, "status": said[0], "seconds": None}


def test_a_point_may_be_any_command(tmp_path: Path) -> None:
    columns = ["point", "ranks", "scene", "converged", "status", "seconds", "extra"]
    batch = Batch(tmp_path, "study", {}, columns, Limits(ranks=2), report=lambda line: None)
    batch.run({"a": Echo()}, lambda record, row: {"extra": row["status"] + "!"})
    (row,) = batch.table.rows()
    assert float(row.pop("seconds")) > 0
    assert list(row.values()) == ["a", "1", "none", "True", "2018", "2018!"]


def test_a_rank_may_start_a_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    monkeypatch.setenv("PMIX_RANK", "1")
    monkeypatch.setenv("OMPI_MCA_rmaps_base_oversubscribe", "1")
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    env = environment()
    assert "PMIX_RANK" not in env and "OMPI_COMM_WORLD_SIZE" not in env
    assert env["OMPI_MCA_rmaps_base_oversubscribe"] == "1" and env["OMP_NUM_THREADS"] == "3"


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
