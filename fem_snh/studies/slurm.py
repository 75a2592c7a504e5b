"""Slurm: the points of a study as arrays of jobs.

For each array, the folder ``jobs`` of a study holds NAME.json (the tasks of the elements) and the
output of the elements. An element runs its task as the study does on this machine:
``python -m fem_snh.studies.slurm FILE.json INDEX``. Whether a point has ended is known only from
end.json in its folder. Slurm is asked only which points wait or run, by the names of the jobs:
names are unique, while job numbers start again if Slurm loses its files. A point that has neither
ended nor is in the queue has lost its job.
"""

from __future__ import annotations

import json
import math
import os
import re
import secrets
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from fem_snh.errors import BadInput, check_whole
from fem_snh.files import read_text, remove, replace_file
from fem_snh.processes import import_path, python
from fem_snh.studies.tasks import End, Task, read_end, run_tasks

#: Seconds of an element in addition to the timeout of its point: imports, the start of MPI.
_OVERHEAD = 120
#: MiB of an element in addition to the memory of its point: the process that starts the point.
_OVERHEAD_MEMORY = 256
#: Largest index of an array that any Slurm accepts (slurm.conf(5), MaxArraySize).
_MOST_ELEMENTS = 4_000_001
#: Seconds after which a command of Slurm that does not answer is given up.
_TIMEOUT = 120
#: States of jobs that do not run any more (squeue(1), JOB STATE CODES).
_ENDED = frozenset(
    "BOOT_FAIL CANCELLED COMPLETED DEADLINE FAILED NODE_FAIL OUT_OF_MEMORY PREEMPTED "
    "REVOKED TIMEOUT".split()
)


@dataclass(frozen=True)
class Slurm:
    """Submission of points to Slurm, in place of ``jobs`` processes of this machine.

    Parameters
    ----------
    account, partition : str, optional
        Account and partition of the jobs; default: the user's.
    array_limit : int, optional
        Elements of an array that run at a time.
    options : sequence of str
        Further options of ``sbatch``.
    """

    account: str | None = None
    partition: str | None = None
    array_limit: int | None = None
    options: Sequence[str] = ()

    def __post_init__(self) -> None:
        if self.array_limit is not None:
            check_whole("array-limit", self.array_limit, 1, _MOST_ELEMENTS)

    def submit(self, out: Path, tasks: Sequence[Task]) -> list[str]:
        """Submit tasks of the study in ``out``, and return a line about each array.

        Raises
        ------
        BadInput
            If Slurm refuses an array, or does not answer. Earlier arrays stay submitted; the next
            call submits the rest.
        """
        found = re.search(r"^MaxArraySize\s*=\s*(\d+)", _output("scontrol", "show", "config"), re.M)
        largest, lines, folder = int(found[1]) if found else 1, [], out / "jobs"
        folder.mkdir(exist_ok=True)
        for start in range(0, len(tasks), largest):
            part = tasks[start : start + largest]
            name = f"fem-snh-{secrets.token_hex(4)}"
            data = folder / f"{name}.json"
            # Written before the submission: points of a job without this file would run twice.
            replace_file(data, json.dumps([asdict(task) for task in part]))
            try:
                answer = _output("sbatch", "--parsable", *self._arguments(data.resolve(), part))
            except BadInput:
                if name not in _elements([name]):  # raises if it does not answer: kept
                    remove(data)
                raise
            number = answer.strip().partition(";")[0]
            lines.append(f"submitted {len(part)} points: job {number} ({name})")
        return lines

    def _arguments(self, data: Path, tasks: Sequence[Task]) -> list[str]:
        """Return the arguments of sbatch; Slurm restarts an element if its node fails."""
        limit = f"%{self.array_limit}" if self.array_limit else ""
        seconds, memory = tasks[0].timeout, tasks[0].memory
        command = shlex.join([*python("fem_snh.studies.slurm"), str(data)])
        given: dict[str, Any] = {
            "job-name": data.stem,
            "array": f"0-{len(tasks) - 1}{limit}",
            "ntasks": tasks[0].ranks,
            "cpus-per-task": 1,
            "account": self.account,
            "partition": self.partition,
            "time": seconds and math.ceil((seconds + _OVERHEAD) / 60),
            "mem": memory and f"{math.ceil(memory * 1024) + _OVERHEAD_MEMORY}M",
            # %% is a percent sign (sbatch(1), FILENAME PATTERN)
            "output": f"{data.with_suffix('')}-".replace("%", "%%") + "%a.txt",
            "open-mode": "append",
            "wrap": f'exec {command} "$SLURM_ARRAY_TASK_ID"',
        }
        options = [f"--{key}={value}" for key, value in given.items() if value is not None]
        return [*options, "--requeue", *self.options]


def queued(out: Path) -> set[str]:
    """Return the names of the points of the study in ``out`` that wait or run.

    Raises
    ------
    BadInput
        If Slurm does not answer, or a file of the folder is damaged.
    """
    jobs = {file.stem: _read(file) for file in _files(out)}
    jobs = {n: tasks for n, tasks in jobs.items() if not all(read_end(out / t.name) for t in tasks)}
    found = {
        task.name
        for name, indices in _elements(list(jobs)).items()
        for index in indices
        for task in jobs[name][index : index + 1]
    }
    # Ends are read after the queue: an element that has left the queue has written its own.
    return {name for name in found if not read_end(out / name)}


def clear(out: Path) -> None:
    """Remove the files of all arrays of a study, whose points must have ended."""
    for file in _files(out):
        for own in file.parent.glob(f"{file.stem}*"):
            remove(own)


def _files(out: Path) -> list[Path]:
    """Return the files NAME.json of the arrays of a study."""
    return sorted((out / "jobs").glob("fem-snh-*.json"))


def _elements(names: Sequence[str]) -> Mapping[str, list[int]]:
    """Return {name of the array: indices of the elements that wait or run}.

    Raises BadInput if Slurm does not answer: then nothing is known.
    """
    found: dict[str, list[int]] = {}
    if names:
        words = "--noheader", "--array", "--states=all", "--format=%j|%K|%T|%r"
        for line in _output("squeue", *words, f"--name={','.join(names)}").splitlines():
            name, index, state, reason = line.strip().split("|", 3)
            # An element that is held after a failed launch waits for nothing: it is lost. Should it
            # be released, it does not run a point that has ended.
            if state not in _ENDED and reason != "launch failed requeued held":
                found.setdefault(name, []).append(int(index))
    return found


def _output(*command: str) -> str:
    """Return what a command of Slurm prints; raise BadInput if it fails."""
    try:
        return subprocess.run(
            command, check=True, capture_output=True, text=True, timeout=_TIMEOUT,
            stdin=subprocess.DEVNULL,
            env=dict(os.environ) | import_path(),  # which an element inherits
        ).stdout  # fmt: skip
    except FileNotFoundError:
        raise BadInput(f"Slurm: expected its command {command[0]} on the PATH") from None
    except subprocess.TimeoutExpired:
        raise BadInput(f"Slurm: {command[0]} does not answer in {_TIMEOUT} s") from None
    except subprocess.CalledProcessError as error:
        lines = (error.stderr or error.stdout).strip().splitlines()
        reason = lines[-1] if lines else f"exit code {error.returncode}"
        raise BadInput(
            f"Slurm: {command[0]}: {reason.removeprefix(command[0] + ': ')} (nothing is lost: "
            "call again later)"
        ) from None


def _read(file: Path) -> list[Task]:
    """Return the tasks of NAME.json; raise BadInput if it is damaged."""
    try:
        return TypeAdapter(list[Task]).validate_json(read_text(file))
    except (OSError, ValueError):
        raise BadInput(
            f"{file} is damaged: expected the points of a job: remove it if none is in the queue"
        ) from None


def main(file: str, index: str) -> int:
    """Run the task of an element of an array, unless it has ended; return 0.

    Slurm may start an element a second time.
    """
    out, task = Path(file).parents[1], _read(Path(file))[int(index)]

    def report(task: Task, end: End) -> None:
        print(f"{task.name}: exit code {end.code}, {end.seconds:.1f} s {end.limit}", flush=True)

    run_tasks(out, [task] if read_end(out / task.name) is None else [], 1, report)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
