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
from slurm_cluster import PROCESSORS, Cluster, counted_points, missing, wait_for

from fem_snh import cli
from fem_snh.errors import BadInput
from fem_snh.studies.batch import Batch
from fem_snh.studies.jobs import Jobs, Task
from fem_snh.studies.points import Limits
from fem_snh.studies.schedulers import Submission

pytestmark = pytest.mark.one_debian

COLUMNS = ["point", "number", "ranks", "converged", "status", "seconds"]
WITH_SLURM = pytest.mark.skipif(bool(missing()), reason=missing() or "Slurm is here")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with pytest.MonkeyPatch.context() as patch, Cluster(tmp_path_factory.mktemp("slurm")) as made:
        patch.setenv("SLURM_CONF", made.variables["SLURM_CONF"])
        yield made


def study(out: Path, submission: Submission, lines: list[str] | None = None) -> Batch:
    report = (lines if lines is not None else []).append
    return Batch(out, "study", {}, COLUMNS, Limits(submission), report=report)


@WITH_SLURM
def test_nothing_is_lost_and_nothing_runs_twice(cluster: Cluster, tmp_path: Path) -> None:
    """60 points; slurmctld is killed and started again, a job is killed, a node fails."""
    runs = tmp_path / "runs.txt"
    points = counted_points(tmp_path, 60, runs)
    out, submission = tmp_path / "out", Submission(chunk=2)
    lines: list[str] = []
    with study(out, submission, lines) as batch:
        assert not batch.run(points)
        # MaxArraySize is 20: two arrays.
        sizes = [int(n) for n in re.findall(r"(\d+) elements of job", " ".join(lines))]
        assert sizes == [20, 10]
        assert not batch.run(points) and len(list((out / "jobs").glob("*.json"))) == 2

    wait_for(lambda: runs.exists() and len(runs.read_text().split()) >= 5)
    cluster.kill_controller()
    with study(out, submission) as batch, pytest.raises(BadInput, match="nothing is lost"):
        batch.run(points)
    assert len(list((out / "jobs").glob("*.json"))) == 2
    cluster.start_controller()

    wait_for(cluster.running)
    killed = cluster.running()[0]
    cluster.run("scancel", killed)
    wait_for(lambda: len(cluster.running()) > 1 or cluster.resume(), 0.5)
    on_node = len(cluster.running())  # these may run a second time
    cluster.run("scontrol", "update", f"nodename={cluster.host}", "state=down", "reason=test")
    wait_for(lambda: not cluster.running())

    def settle() -> None:
        wait_for(lambda: not Jobs(out).queued() or cluster.resume(), 0.5)

    settle()
    lines.clear()
    with study(out, submission, lines) as batch:
        assert not batch.run(points)
        # The job that was killed, and what a controller forgets that is killed before it saves.
        (lost,) = (int(n) for n in re.findall(r"submitted (\d+) points", " ".join(lines)))
        assert 1 <= lost <= 2 * (10 + 1) and len(pd.read_csv(batch.table)) == 60 - lost
        settle()
        assert batch.run(points)
        rows = pd.read_csv(batch.table).to_dict("records")
    assert sorted(row["point"] for row in rows) == sorted(points)
    for row in rows:
        assert row["status"].endswith(f"its square is {int(row['number']) ** 2}")
    repeated = {name for name, n in Counter(runs.read_text().split()).items() if n > 1}
    # A controller that has lost its last seconds starts again what it believes to be waiting.
    assert len(repeated) <= 2 * (on_node + 1 + PROCESSORS)
    assert Jobs(out).status("study") == {"points": 60, "in the table": 60}


@WITH_SLURM
def test_commands(cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sweep of runs on 2 ranks: submitted, refused here meanwhile, its status, its rows."""
    out = ["--out", str(tmp_path / "out")]
    words = ["sweep", "twist", "--cells", "2", "--set", "steps=1", "--nu", "0.3,0.4", *out]
    slurm = ["--scheduler", "slurm", "--array-limit", "2", "--ranks", "2", "--partition", "main"]
    node = "scontrol", "update", f"nodename={cluster.host}"
    cluster.run(*node, "state=drain", "reason=test")  # nothing starts meanwhile
    assert cli.main([*words, *slurm, "--timeout", "100", "--memory", "2"]) == 0
    assert "submitted 2 points: 2 elements" in capsys.readouterr().out
    assert cli.main([*words, "--ranks", "2"]) == 2
    assert "are in the queue of a scheduler" in capsys.readouterr().err
    assert cli.main([*words, *slurm, "--overwrite"]) == 2
    assert cli.main(["sweep", "--collect", *out]) == 1
    assert "2 points: 2 pending" in capsys.readouterr().out
    cluster.run(*node, "state=resume")
    wait_for(lambda: not Jobs(tmp_path / "out").queued() or cluster.resume(), 0.5)
    assert cli.main(["sweep", "--status", *out]) == 1
    assert "2 points: 2 ended" in capsys.readouterr().out
    assert cli.main(["sweep", "--collect", *out]) == 0
    assert "2 of 2 points converged" in capsys.readouterr().out
    for nu in (0.3, 0.4):
        record = json.loads((tmp_path / "out" / f"nu={nu}" / "run.json").read_text())
        assert record["ranks"] == 2 and record["converged"]


def slurm_words(line: str) -> list[str]:
    """Read the options of an #SBATCH line as Slurm 22.05 does (``get_argument`` of its sbatch)."""
    words, word, quote, escaped = [], "", "", False
    for letter in line.removeprefix("#SBATCH") + " ":
        if letter.isspace() and not quote:
            words += [word] * bool(word)
            word = ""
        elif escaped:
            word, escaped = word + letter, False
        elif letter == "\\":
            escaped = True
        elif quote:
            word, quote = (word, "") if letter == quote else (word + letter, quote)
        elif letter in "'\"":
            quote = letter
        elif letter == "#":
            break
        else:
            word += letter
    return words


@pytest.mark.parametrize("name", ["a b", "{x} {index}", 'it\'s "$HOME" #1 50% $(false);', "ü\\n"])
def test_paths_are_quoted_for_slurm_and_for_the_shell(tmp_path: Path, name: str) -> None:
    out = tmp_path / name
    (out / "fem_snh_element").mkdir(parents=True)
    scheduler = out / "record.py"
    scheduler.write_text(RECORDING)
    Jobs(out).submit([Task("p", (), 1)], Submission(f"{scheduler}:Recording", account=name))
    (script,) = (out / "jobs").glob("*.sh")
    lines = script.read_text().splitlines()
    options = [word for line in lines if line.startswith("#SBATCH") for word in slurm_words(line)]
    assert f"--account={name}" in options
    log = f"{out}/jobs/{script.stem}-%a.txt".replace("%", "%%").replace("%%a.txt", "%a.txt")
    assert f"--output={log}" in options
    assert lines[-1].startswith("exec ")
    echo = lines[-1].replace("exec ", "printf '%s\\n' ", 1)
    said = subprocess.run(["bash", "-c", echo], capture_output=True, text=True, check=True,
                          env={"SLURM_ARRAY_TASK_ID": "7"}).stdout  # fmt: skip
    assert said.endswith(f"\n{script.with_suffix('.json')}\n7\n")


#: A scheduler that records when its file is executed, and has every element in its queue.
RECORDING = """
from pathlib import Path
from fem_snh.studies.schedulers import Slurm

(Path(__file__).parent / "executed").touch()

class Recording(Slurm):
    def largest_array(self):
        return 10
    def submit(self, script):
        return "1"
    def states(self, names):
        return {name: {0: "pending", 99: "running"} for name in names}
"""


def test_a_folder_does_not_choose_what_is_executed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file, executed = tmp_path / "record.py", tmp_path / "executed"
    file.write_text(RECORDING)
    out = ["--out", str(tmp_path / "out")]
    scheduler = ["--scheduler", f"{file}:Recording"]
    words = ["sweep", "twist", "--cells", "2", "--nu", "0.3", *out]
    assert cli.main([*words, *scheduler]) == 0
    assert "later: the same command again" in capsys.readouterr().out
    executed.unlink()
    file.write_text(file.read_text() + "\n")  # another file: it would be executed again
    assert cli.main(["sweep", "--status", *out]) == 1
    assert "1 points: 1 submitted" in capsys.readouterr().out
    assert cli.main(["sweep", "--collect", *out]) == 2
    assert "expected no Python file with --collect" in capsys.readouterr().err
    assert cli.main(words) == 2
    assert "are in the queue of a scheduler" in capsys.readouterr().err
    assert not executed.exists()
    assert cli.main(["sweep", "--status", *out, *scheduler]) == 1
    assert "1 points: 1 pending" in capsys.readouterr().out and executed.exists()


@pytest.mark.parametrize("command", ["--status", "--collect"])
def test_damaged_jobs_are_one_line(
    command: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every value of the file is replaced by values of other types, or missing."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "record.py").write_text(RECORDING)
    words = ["sweep", "twist", "--cells", "2", "--nu", "0.3", "--out", "out"]
    assert cli.main([*words, "--scheduler", "record.py:Recording"]) == 0
    (file,) = Path("out/jobs").glob("*.json")
    data = json.loads(file.read_text())
    texts = ["", "[", "nul", "[]", "3", "{}", '"a"', "[" * 10_000, '{"elements": []}']
    texts += [json.dumps({k: v for k, v in data.items() if k != key}) for key in data]
    task_data = data["elements"][0][0]
    for bad in (None, 3, "a\0b", [], [[3]], {}, {"a": 1}):
        texts += [json.dumps(data | {key: bad}) for key in data]
        texts += [
            json.dumps(data | {"elements": [[task_data | {key: bad}]]})
            for key in ("name", "arguments", "ranks", "timeout")
        ]
    texts.append(json.dumps(data | {"command": ["sweep", "twist", "--collect", "--out", "out"]}))
    capsys.readouterr()
    for text in texts:
        file.write_text(text)
        assert cli.main(["sweep", command, "--out", "out"]) in (1, 2), text
        printed = capsys.readouterr()
        assert len((printed.out + printed.err).splitlines()) == 1, (text, printed)
