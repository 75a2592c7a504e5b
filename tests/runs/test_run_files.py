"""Output never removes or replaces what is not its own: other files of the folder, and inputs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from mpi4py import MPI

import pytest
from interrupted_runs import solve

import fem_snh
from fem_snh import scenes
from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.records import run_files
from fem_snh.studies.sweep import sweep

mpi = pytest.mark.mpi

#: Names of files that earlier versions removed, and names that a run writes.
NAMES = (
    "obstacle_table.stl", "bone_a.stl", "bone_b.obj", "fields_mine.vtu", "fields.old.pvd",
    "skin_of_hand.vtu", "modes1.vtu", "obstacles_seen.vtu", "steps.csv", "modes.csv",
    "checkpoint.npz", "fields.pvd", "fields000000.pvtu", "fields_p0_000000.vtu", "skin.pvd",
    "skin000001.vtu", "obstacles.pvd", "obstacles000000.vtu", "modes.pvd", "obstacle_0.stl",
    "bone_0.stl", "notes.txt", "mesh.msh",
)  # fmt: skip
#: Those that a run of `TWIST` writes.
WRITTEN = (
    "run.json", "steps.csv", "checkpoint.npz", "fields.pvd", "fields000000.pvtu",
    "fields000001.pvtu", "fields_p0_000000.vtu", "fields_p0_000001.vtu",
)  # fmt: skip
#: Those that no run writes.
OTHERS = ("notes.txt", "mesh.msh", "scene.py", "fields_mine.vtu", "obstacle_table.stl")
TWIST: dict[str, Any] = {"cells": 1, "steps": 1, "angle": 0.1}
MINE = "mine"


def fill(folder: Path, names: Any) -> Path:
    """Write files of somebody else's."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_text(MINE)
    return folder


def unchanged(folder: Path) -> set[str]:
    """Return the names of the files that are as `fill` has written them."""
    files = (path for path in folder.iterdir() if path.is_file())
    return {path.name for path in files if path.read_bytes() == MINE.encode()}


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Return the message of a command that ends with exit code 2 and one line."""
    assert main(list(words)) == 2
    output = capsys.readouterr()
    assert re.fullmatch(r"fem-snh: error: [^\n]*\n", output.err), output.err
    return output.err


# --- runs -----------------------------------------------------------------------------------------


@pytest.mark.one_debian
@pytest.mark.parametrize("name", NAMES)
def test_a_folder_with_other_files_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    fill(tmp_path, [name])
    message = refusal(capsys, "run", "twist", "--out", str(tmp_path))
    assert f"({name}): expected an empty folder, or --overwrite" in message
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert unchanged(tmp_path) == {name}


def test_the_working_directory_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As --out . beside a scene and its files; --out "" is no folder."""
    monkeypatch.chdir(fill(tmp_path, ("obstacle_table.stl", "s.toml")))
    assert "(obstacle_table.stl, s.toml)" in refusal(capsys, "run", "twist", "--out", ".")
    assert unchanged(tmp_path) == {"obstacle_table.stl", "s.toml"}
    for command in (
        "run twist --out", "sweep twist --out",
        "plot x --out", "render x --out", "render x --movie", "view x --out", "export x",
        "materials --table --csv",
    ):  # fmt: skip
        assert "path = '': expected a path" in refusal(capsys, *command.split(), "")
    for out in ("", " ", "a\0b"):
        with pytest.raises(BadInput, match=r"out = .*: expected a path"):
            fem_snh.run("twist", out=out)
        with pytest.raises(BadInput, match=r"out = .*: expected a path"):
            sweep("twist", out, {})
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.one_debian("ranks")
@mpi
def test_overwrite_removes_the_names_of_runs_and_no_others(
    comm: MPI.Intracomm, folder: Path
) -> None:
    """Those of another number of steps and ranks too; and whatever run.json says."""
    solve("twist", out=folder, **TWIST | {"steps": 3})
    if comm.rank == 0:
        record = json.loads((folder / "run.json").read_text())
        assert record["files"] == sorted(path.name for path in folder.iterdir())
        fill(folder, [*OTHERS, "fields000009.pvtu", "obstacle_7.stl"])
        record["files"] += ["mesh.msh", "../x", "notes.txt", 7]  # a list that was edited
        (folder / "run.json").write_text(json.dumps(record))
    comm.barrier()
    solve("twist", MPI.COMM_SELF, out=folder, overwrite=True, **TWIST)
    if comm.rank == 0:
        assert {path.name for path in folder.iterdir()} == {*WRITTEN, *OTHERS}
        assert unchanged(folder) == {*OTHERS}
        assert json.loads((folder / "run.json").read_text())["files"] == sorted(WRITTEN)
    comm.barrier()


@mpi
@pytest.mark.parametrize(
    "name", ["obstacle_0.stl", "bone_1.stl", "rigid_0.obj", "steps.csv", "checkpoint.npz"]
)
@pytest.mark.parametrize("linked", [False, True])
def test_an_input_is_never_replaced(
    comm: MPI.Intracomm, folder: Path, name: str, linked: bool
) -> None:
    """Not even with overwrite, under a name of a run's files, or by way of a link."""
    out, file = folder / "out", folder / "out" / name
    if comm.rank == 0:
        fill(out, [name])
        if linked:
            (folder / "link").symlink_to(file)
    comm.barrier()
    material = scenes.MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3)
    mesh = folder / "link" if linked else file
    scene = scenes.Scene(name="s", mesh=mesh, element="P1", material=material)
    for overwrite, message in (
        (False, "holds files of no run"),
        (True, "of the input .* are writ"),
    ):
        with pytest.raises(BadInput, match=f"out = .*: .*{message}"):
            solve(scene, out=out, overwrite=overwrite)
    comm.barrier()
    assert unchanged(out) == {name}
    comm.barrier()


# --- studies --------------------------------------------------------------------------------------


def test_a_sweep_leaves_folders_of_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whose log.txt makes them no point; in those of its points it leaves other files."""
    out = tmp_path / "out"
    values = {"cells": 1, "steps": 1, "angle": [0.1, 0.2]}
    sweep("twist", out, values, report=lambda line: None)
    fill(out / "mine", ["log.txt", "run.json", "data.csv"])
    fill(out / "angle=0.1", ["notes.txt", "fields_mine.vtu"])
    definition = json.loads((out / "sweep.json").read_text())
    assert definition["axes"]["angle"] == [0.1, 0.2]
    definition["axes"]["angle"] += ["../other", "mine/..", "."]
    fill(tmp_path / "other", ["log.txt"])
    (out / "sweep.json").write_text(json.dumps(definition))
    sweep("twist", out, values | {"angle": 0.1}, overwrite=True, timeout=0.01, report=print)
    assert unchanged(out / "mine") == {"log.txt", "run.json", "data.csv"}
    assert unchanged(tmp_path / "other") == {"log.txt"}
    assert unchanged(out / "angle=0.1") == {"notes.txt", "fields_mine.vtu"}
    assert not (out / "angle=0.1" / "run.json").exists() and not (out / "angle=0.2").exists()
    assert (out / "point" / "log.txt").exists()


def test_a_second_study_of_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    lock = run_files.FolderLock(tmp_path / ".study")
    with pytest.raises(BadInput, match="another process writes into this folder"):
        sweep("twist", tmp_path, TWIST)
    lock.close()
    table = sweep("twist", tmp_path, TWIST, report=lambda line: None)
    assert table["converged"].all() and not (tmp_path / ".study").exists()
