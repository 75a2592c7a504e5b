"""Studies that a real Slurm runs: lost jobs, a controller that is killed, elements on ranks."""

from __future__ import annotations

import json
import re
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from slurm_cluster import PROCESSORS, Cluster, counted_scene, missing, wait_for

from fem_snh import cli
from fem_snh.errors import BadInput
from fem_snh.studies import slurm
from fem_snh.studies.slurm import Slurm, queued
from fem_snh.studies.sweep import sweep
from fem_snh.studies.tasks import Task

pytestmark = pytest.mark.one_debian

WITH_SLURM = pytest.mark.skipif(bool(missing()), reason=missing() or "Slurm is here")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with pytest.MonkeyPatch.context() as patch, Cluster(tmp_path_factory.mktemp("slurm")) as made:
        patch.setenv("SLURM_CONF", made.variables["SLURM_CONF"])
        yield made


@WITH_SLURM
def test_nothing_is_lost_and_nothing_runs_twice(cluster: Cluster, tmp_path: Path) -> None:
    """30 points; slurmctld is killed and started again, a job is killed, a node fails."""
    runs, hold, out = tmp_path / "runs.txt", tmp_path / "hold", tmp_path / "out"
    scene = counted_scene(tmp_path, runs, hold)
    lines: list[str] = []

    def study() -> list[int]:
        lines.clear()
        sweep(scene, out, {"number": list(range(30))}, jobs=Slurm(), report=lines.append)
        return [int(n) for n in re.findall(r"submitted (\d+) points", " ".join(lines))]

    assert study() == [20, 10]  # MaxArraySize is 20: two arrays
    assert study() == [] and len(list((out / "jobs").glob("*.json"))) == 2

    wait_for(lambda: runs.exists() and len(runs.read_text().split()) >= 5)
    hold.touch()  # what runs now still does when it is killed
    cluster.kill_controller()
    with pytest.raises(BadInput, match="nothing is lost"):
        study()
    assert len(list((out / "jobs").glob("*.json"))) == 2
    cluster.start_controller()

    wait_for(cluster.running)
    killed = cluster.running()[0]
    cluster.run("scancel", killed)
    wait_for(lambda: killed not in cluster.running())
    hold.unlink()
    wait_for(lambda: len(cluster.running()) > 1 or cluster.resume(), 0.5)
    on_node = len(cluster.running())  # these may run a second time
    cluster.run("scontrol", "update", f"nodename={cluster.host}", "state=down", "reason=test")
    wait_for(lambda: not cluster.running())

    def settle() -> None:
        wait_for(lambda: not queued(out) or cluster.resume(), 0.5)

    settle()
    # The job that was killed, and what a controller forgets that is killed before it saves.
    (lost,) = study()
    assert 1 <= lost <= 10 + 1 and len(pd.read_csv(out / "sweep.csv")) == 30 - lost
    assert lines[-1].startswith(f"{lost} points wait or run")
    settle()
    assert study() == []
    rows = pd.read_csv(out / "sweep.csv").to_dict("records")
    assert sorted(row["number"] for row in rows) == list(range(30))
    for row in rows:
        assert row["status"].endswith(f"its square is {int(row['number']) ** 2}")
    repeated = {name for name, n in Counter(runs.read_text().split()).items() if n > 1}
    # A controller that has lost its last seconds starts again what it believes to be waiting.
    assert len(repeated) <= on_node + 1 + PROCESSORS


@WITH_SLURM
def test_commands(cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sweep of runs on 2 ranks: submitted, refused here meanwhile, its rows."""
    out = ["--out", str(tmp_path / "out")]
    words = ["sweep", "twist", "--cells", "2", "--set", "steps=1", "--nu", "0.3,0.4", *out]
    slurm_options = ["--scheduler", "slurm", "--array-limit", "2", "--ranks", "2"]
    slurm_options += ["--partition", "main", "--timeout", "100", "--memory", "2"]
    node = "scontrol", "update", f"nodename={cluster.host}"
    cluster.run(*node, "state=drain", "reason=test")  # nothing starts meanwhile
    assert cli.main([*words, *slurm_options]) == 0
    assert "submitted 2 points: job" in capsys.readouterr().out
    assert cli.main([*words, "--ranks", "2"]) == 2
    assert "are in the queue of Slurm" in capsys.readouterr().err
    assert cli.main([*words, *slurm_options, "--overwrite"]) == 2
    assert cli.main([*words, *slurm_options]) == 0
    assert "2 points wait or run" in capsys.readouterr().out
    cluster.run(*node, "state=resume")
    wait_for(lambda: not queued(tmp_path / "out") or cluster.resume(), 0.5)
    assert cli.main([*words, *slurm_options]) == 0
    assert "2 of 2 points converged" in capsys.readouterr().out
    for nu in (0.3, 0.4):
        record = json.loads((tmp_path / "out" / f"nu={nu}" / "run.json").read_text())
        assert record["ranks"] == 2 and record["converged"]


@pytest.mark.parametrize("name", ["a b", "{x} {index}", 'it\'s "$HOME" #1 50% $(false);', "ü\\n"])
def test_paths_are_quoted_for_the_shell(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / name
    out.mkdir()
    commands: list[tuple[str, ...]] = []
    monkeypatch.setattr(slurm, "_output", lambda *c: commands.append(c) or "MaxArraySize = 10\n")
    Slurm(account=name).submit(out, [Task("p", (), 1)])
    (file,) = (out / "jobs").iterdir()
    assert f"--account={name}" in commands[-1]
    log = f"{out}/jobs/{file.stem}-%a.txt".replace("%", "%%").replace("%%a.txt", "%a.txt")
    assert f"--output={log}" in commands[-1]
    (wrap,) = [word.partition("=")[2] for word in commands[-1] if word.startswith("--wrap=")]
    echo = wrap.replace("exec ", "printf '%s\\n' ", 1)
    said = subprocess.run(["sh", "-c", echo], capture_output=True, text=True, check=True,
                          env={"SLURM_ARRAY_TASK_ID": "7"}).stdout  # fmt: skip
    assert said.endswith(f"\n{file}\n7\n")


def test_damaged_jobs_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answers = {"scontrol": "MaxArraySize = 10\n", "sbatch": "1\n", "squeue": ""}
    monkeypatch.setattr(slurm, "_output", lambda *command: answers[command[0]])
    words = ["sweep", "twist", "--cells", "2", "--nu", "0.3", "--out", "out"]
    assert cli.main([*words, "--scheduler", "slurm"]) == 0
    (file,) = Path("out/jobs").glob("*.json")
    (task,) = json.loads(file.read_text())
    texts = ["", "[", "nul", "3", "{}", '"a"', "[" * 10_000, '[{"elements": []}]']
    for bad in (None, 3, [], {}, {"a": 1}):
        texts += [json.dumps([task | {key: bad}]) for key in ("name", "arguments", "ranks")]
    capsys.readouterr()
    for text in texts:
        file.write_text(text)
        assert cli.main([*words, "--scheduler", "slurm"]) in (0, 2), text
        assert len(capsys.readouterr().err.splitlines()) <= 1, text
