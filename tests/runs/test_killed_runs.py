"""Runs that are killed between two writes: every series is whole after they are resumed."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import pyvista as pv
from interrupted_runs import ALL, ALONE, solve

import fem_snh
from fem_snh import files, scenes
from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.records import run_files
from fem_snh.studies.tasks import environment, program

#: A ball in a lattice, which has a skin, falls past a plane that moves, in two steps.
SCENE = scenes.Scene(
    name="ball",
    mesh=scenes.Lattice(lattice={"sphere": {"center": [0, 0, 0], "radius": 0.5}}, cell=0.4),
    element="Q1",
    steps=2,
    material=scenes.MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3),
    bone=[{"name": "core", "motion": lambda load: np.column_stack([np.eye(3), [0, 0, -0.1 * load]]),
           "shape": {"sphere": {"center": [0, 0, 0], "radius": 0.4}}}],
    obstacle=[{"name": "floor", "shape": {"plane": {"point": [0, 0, -2], "normal": [0, 0, 1]}},
               "translate": [0, 0, 0.2]}],
    fields=["von_mises"],
)  # fmt: skip
SERIES = ("fields.pvd", "obstacles.pvd", "skin.pvd")
#: Files that an output replaces: of a state its checkpoint, two of the obstacles, three of the
#: fields and two of the skin; steps.csv, run.json.
OUTPUT = 10


class Killed(BaseException):
    """An end of the process that no handler sees."""


@contextmanager
def killed_after(replacements: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """End the process before a file replaces another for the ``replacements`` + 1-th time.

    What a killed process leaves is left: nothing is removed or written afterwards.
    """
    replace, count = os.replace, itertools.count()
    with monkeypatch.context() as patch:

        def counted(source: Any, target: Any) -> None:
            if next(count) >= replacements:
                patch.setattr(files, "remove", lambda path: None)
                patch.setattr(run_files.FolderLock, "close", lambda self: self.file.close())
                raise Killed
            replace(source, target)

        patch.setattr(os, "replace", counted)
        try:
            yield
        except Killed:
            pass


def bounds(values: Any) -> np.ndarray:
    return np.array([np.min(values, axis=0), np.max(values, axis=0)])


def contents(folder: Path) -> dict[str, Any]:
    """Return values of every state of every series of a run, whatever the order of the cells."""
    found: dict[str, Any] = {}
    for series in SERIES:
        reader: Any = pv.get_reader(str(folder / series))
        for t in reader.time_values:
            reader.set_active_time_value(t)
            grid = reader.read().combine()
            for name in grid.cell_data:
                found[(series, t, name)] = np.sort(grid.cell_data[name], axis=0)
            for name in set(grid.point_data.keys()) - {"vtkGhostType"}:
                found[(series, t, name)] = bounds(grid.point_data[name])
            found[(series, t, "points")] = bounds(grid.points)
    return found


def steps(folder: Path) -> list[dict[str, Any]]:
    record = json.loads((folder / "run.json").read_text())
    assert record["converged"]
    return [step | {"seconds": 0} for step in record["steps"]]


def visible(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = ALL.bcast(tmp_path_factory.mktemp("whole"))
    solve(SCENE, ALONE, out=folder)
    return folder


def test_killed_between_any_two_writes(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the run is resumed its series, rows and files are those of an uninterrupted run."""
    expected, rows = contents(whole), steps(whole)
    for count in range(OUTPUT, 2 * OUTPUT + 1):  # of the first step
        folder = tmp_path / f"{count}"
        with killed_after(count, monkeypatch):
            solve(SCENE, out=folder)
        left = {name for name in visible(folder) if not name.startswith(".")}
        assert ".lock" in visible(folder) and left == set(run_files.run_files(folder))
        solve(SCENE, out=folder, resume=True)
        found = contents(folder)
        assert found.keys() == expected.keys(), count
        assert all(np.array_equal(found[key], expected[key]) for key in expected), count
        assert steps(folder) == rows and visible(folder) == visible(whole), count


@pytest.mark.mpi
def test_killed_on_one_rank_and_resumed_on_all(
    whole: Path, folder: Path, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the checkpoint and the last series, of which it lost a state for good."""
    out = folder / "out"
    for count in range(OUTPUT + 2, OUTPUT + 5):
        with killed_after(count, monkeypatch):
            solve(SCENE, ALONE, out=out, overwrite=True)
        solve(SCENE, ALL, out=out, resume=True)
        comm.barrier()
        if comm.rank == 0:
            expected, found = contents(whole), contents(out)
            assert found.keys() == expected.keys(), count
            for key, values in expected.items():
                assert found[key] == pytest.approx(values, rel=1e-6, abs=1e-6), (count, key)
            record = json.loads((out / "run.json").read_text())
            assert sorted(record["files"]) == visible(out)
        comm.barrier()


def test_the_system_releases_the_folder_of_a_killed_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Meanwhile a second run is refused in one line; its files are the first one's."""
    out = tmp_path / "out"
    words = ["run", "stretch", "--cells", "3", "--steps", "500", "--quiet", "--out", str(out)]
    first = subprocess.Popen([*program(1), *words], env=environment())
    try:
        late = time.monotonic() + 120
        while not (out / "fields000001.pvtu").exists():
            assert first.poll() is None and time.monotonic() < late
            time.sleep(0.02)
        for option in ("--overwrite", "--resume"):
            assert main([*words, option]) == 2
            message = r"fem-snh: error: out = .*: another process writes into this folder: .*\n"
            assert re.fullmatch(message, capsys.readouterr().err)
        assert first.poll() is None
    finally:
        first.kill()
        first.wait()
    assert first.returncode == -signal.SIGKILL and (out / ".lock").exists()
    left = {name for name in visible(out) if not name.startswith(".")}
    assert left == set(run_files.run_files(out))
    fem_snh.run("stretch", cells=3, out=out, overwrite=True, comm=ALONE, progress=False)
    assert visible(out) == sorted(json.loads((out / "run.json").read_text())["files"])


@pytest.mark.mpi
def test_a_folder_in_use_is_refused_on_every_rank(comm: MPI.Intracomm, folder: Path) -> None:
    lock = run_files.FolderLock(folder / run_files.LOCK) if comm.rank == 0 else None
    comm.barrier()
    with pytest.raises(BadInput, match="another process writes into this folder"):
        solve("twist", cells=1, steps=1, out=folder)
    if lock:
        lock.close()
    comm.barrier()
    assert solve("twist", cells=1, steps=1, angle=0.1, out=folder).converged
