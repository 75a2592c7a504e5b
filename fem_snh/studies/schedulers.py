"""Batch systems that run the points of a study as arrays of jobs: Slurm, or one of the user's.

A scheduler submits a script and tells the states of what it has in its queue. It is asked by the
name of a job, which is unique, never by a number: numbers start again where a scheduler has lost
its own files.
"""

from __future__ import annotations

import math
import os
import re
import subprocess
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from fem_snh.errors import BadInput, bad_value, check_whole, choose
from fem_snh.processes import import_path
from fem_snh.references import is_reference, load_reference

#: Seconds of an element beside the timeouts of its points: imports, the start of MPI.
_OVERHEAD = 120
#: MiB of an element beside the memory of its point: the process that starts it.
_OVERHEAD_MEMORY = 256
#: Largest index of an array that any Slurm accepts (slurm.conf(5), MaxArraySize).
_MOST_ELEMENTS = 4_000_001
#: Seconds after which a command of a scheduler that does not answer is given up.
_TIMEOUT = 120


@dataclass(frozen=True)
class Submission:
    """Points are submitted to a scheduler, in place of ``jobs`` processes of this machine.

    Parameters
    ----------
    scheduler : str
        ``slurm``, or ``FILE.py:CLASS`` of a `Scheduler`.
    account, partition : str, optional
        Those of the scheduler; default: the user's.
    array_limit : int, optional
        Elements of an array that run at a time.
    chunk : int
        Points in one element, which run one after another.
    options : sequence of str
        Further options of the scheduler's command of submission.
    submit : bool
        Submit points; False: only take the results of those that have ended.
    command : sequence of str
        The arguments of ``fem-snh`` that define the study, for ``--collect``.
    """

    scheduler: str = "slurm"
    account: str | None = None
    partition: str | None = None
    array_limit: int | None = None
    chunk: int = 1
    options: Sequence[str] = ()
    submit: bool = True
    command: Sequence[str] = ()

    def __post_init__(self) -> None:
        check_whole("chunk", self.chunk, 1, _MOST_ELEMENTS)
        if self.array_limit is not None:
            check_whole("array-limit", self.array_limit, 1, _MOST_ELEMENTS)
        make_scheduler(self.scheduler)


@dataclass(frozen=True)
class Array:
    """An array of jobs: elements with numbers from 0 that run the same command.

    Parameters
    ----------
    name : str
        Its name, which no other job has.
    elements : int
        The number of elements.
    ranks : int
        MPI ranks of each.
    log : Path
        Folder for the output of the elements.
    command : str
        A line of shell: ``command.format(index=...)``, where the index is the element's number.
    seconds, memory : float, optional
        What each needs at most [s, GiB].
    """

    name: str
    elements: int
    ranks: int
    log: Path
    command: str
    seconds: float | None = None
    memory: float | None = None


class Scheduler(ABC):
    """What a study needs of a batch system. Derive a class from it for one of yours."""

    @abstractmethod
    def largest_array(self) -> int:
        """Return the largest number of elements of an array."""

    @abstractmethod
    def script(self, array: Array, submission: Submission) -> str:
        """Return the script of an array."""

    @abstractmethod
    def submit(self, script: Path) -> str:
        """Submit a script and return its number; raise BadInput if the scheduler refuses it."""

    @abstractmethod
    def states(self, names: Sequence[str]) -> Mapping[str, Mapping[int, str]]:
        """Return ``{name: {index: state}}`` of elements that wait or run.

        Raises BadInput if the scheduler does not answer: then nothing is known.
        """


class Slurm(Scheduler):
    """Slurm, by its commands ``sbatch``, ``squeue`` and ``scontrol``."""

    #: States of jobs that do not run any more (squeue(1), JOB STATE CODES).
    _ENDED: ClassVar = frozenset(
        "BOOT_FAIL CANCELLED COMPLETED DEADLINE FAILED NODE_FAIL OUT_OF_MEMORY PREEMPTED "
        "REVOKED TIMEOUT".split()
    )

    def largest_array(self) -> int:
        """Return MaxArraySize of slurm.conf."""
        found = re.search(r"^MaxArraySize\s*=\s*(\d+)", _output("scontrol", "show", "config"), re.M)
        return int(found[1]) if found else 1

    def script(self, array: Array, submission: Submission) -> str:
        """Return the script; Slurm starts an element again whose node has failed (``requeue``)."""
        limit = f"%{submission.array_limit}" if submission.array_limit else ""
        given: dict[str, Any] = {
            "job-name": array.name,
            "array": f"0-{array.elements - 1}{limit}",
            "ntasks": array.ranks,
            "cpus-per-task": 1,
            "account": submission.account,
            "partition": submission.partition,
            "time": array.seconds and math.ceil((array.seconds + _OVERHEAD) / 60),
            "mem": array.memory and f"{math.ceil(array.memory * 1024) + _OVERHEAD_MEMORY}M",
            # %% is a percent sign (sbatch(1), FILENAME PATTERN)
            "output": f"{array.log}/{array.name}-".replace("%", "%%") + "%a.txt",
            "open-mode": "append",
        }
        lines = [f"--{key}={_quote(value)}" for key, value in given.items() if value is not None]
        lines += ["--requeue", *submission.options]
        for line in lines:
            if re.search(r"[\n\r\0]", line):  # what follows would be a line of the script
                raise bad_value("option of sbatch", line, "one line")
        command = array.command.format(index='"$SLURM_ARRAY_TASK_ID"')
        directives = [f"#SBATCH {line}" for line in lines]
        return "\n".join(["#!/bin/bash", *directives, f"exec {command}", ""])

    def submit(self, script: Path) -> str:
        """Submit a script and return the number of the job."""
        return _output("sbatch", "--parsable", str(script)).strip().partition(";")[0]

    def states(self, names: Sequence[str]) -> Mapping[str, Mapping[int, str]]:
        """Return what squeue lists, but for jobs that have ended."""
        found: dict[str, dict[int, str]] = defaultdict(dict)
        if names:
            words = "--noheader", "--array", "--states=all", "--format=%j|%K|%T|%r"
            for line in _output("squeue", *words, f"--name={','.join(names)}").splitlines():
                name, index, state, reason = line.strip().split("|", 3)
                # An element that is held waits for its user, or after a failed launch for nothing:
                # it is lost. Should it be released, it does not run a point that has ended.
                if state not in self._ENDED and reason != "launch failed requeued held":
                    found[name][int(index)] = "held" if "held" in reason.lower() else state.lower()
        return found


def _quote(value: object) -> str:
    """Return a value as one word of an ``#SBATCH`` line, which is not read as the shell reads it.

    Inside double quotes a backslash precedes any character, and older versions of Slurm begin a
    comment at ``#``.
    """
    text = str(value)
    if re.fullmatch(r"[\w%@=+:,./-]*", text):
        return text
    return '"' + re.sub(r'(["\\#])', r"\\\1", text) + '"'


def make_scheduler(name: str) -> Scheduler:
    """Return a scheduler by its name or by a reference ``FILE.py:CLASS``."""
    if not is_reference(name):
        choose("scheduler", name, ["slurm"])
        return Slurm()
    made = load_reference(name)()
    if not isinstance(made, Scheduler):
        raise BadInput(f"scheduler = {name}: expected a subclass of {__name__}.Scheduler")
    return made


def _output(*command: str) -> str:
    """Return what a command of the scheduler prints; raise BadInput if it fails."""
    try:
        return subprocess.run(
            command, check=True, capture_output=True, text=True, timeout=_TIMEOUT,
            stdin=subprocess.DEVNULL,
            env=dict(os.environ) | import_path(),  # which an element inherits
        ).stdout  # fmt: skip
    except FileNotFoundError:
        raise BadInput(f"scheduler: expected its command {command[0]} on the PATH") from None
    except subprocess.TimeoutExpired:
        raise BadInput(f"scheduler: {command[0]} does not answer in {_TIMEOUT} s") from None
    except subprocess.CalledProcessError as error:
        lines = (error.stderr or error.stdout).strip().splitlines()
        reason = lines[-1] if lines else f"exit code {error.returncode}"
        raise BadInput(
            f"scheduler: {command[0]}: {reason.removeprefix(command[0] + ': ')} (nothing is lost: "
            "call again later)"
        ) from None
