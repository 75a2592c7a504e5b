"""The points of a study that were submitted to a scheduler: the folder ``jobs`` of the study.

It holds for each array NAME.json (the tasks of its elements), NAME.sh (its script) and the output
of its elements. That a point has ended is known from the file in its own folder alone; the
scheduler is asked only for points that wait or run. Hence nothing depends on the files of the
scheduler, and a point whose job was lost is one that has neither ended nor is in the queue.
"""

from __future__ import annotations

import json
import os
import secrets
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from pydantic import TypeAdapter

from fem_snh.errors import BadInput
from fem_snh.files import read_text, remove, replace_file
from fem_snh.processes import python
from fem_snh.references import is_reference
from fem_snh.studies.schedulers import Array, Submission, make_scheduler
from fem_snh.studies.tasks import Task, read_end

#: The folder.
JOBS = "jobs"
#: The module that an element runs.
_MODULE = "fem_snh.studies.array_element"


@dataclass(frozen=True)
class _Submitted:
    """The content of NAME.json, and the name."""

    scheduler: str
    command: list[str]
    folder: str
    elements: list[list[Task]]
    name: str = ""


class Jobs:
    """The jobs of a study.

    Parameters
    ----------
    out : Path
        The folder of the study.
    """

    def __init__(self, out: Path) -> None:
        self._out, self.path = out, out / JOBS

    def queued(self, scheduler: str | None = None) -> dict[str, str]:
        """Return the points that wait or run, and the states of their elements.

        Parameters
        ----------
        scheduler : str, optional
            The scheduler that the user names. No other Python file is executed, only because it
            is named in the folder: its points that have not ended are "submitted".

        Raises
        ------
        BadInput
            If a scheduler does not answer, or a file of the folder is damaged.
        """
        waiting: dict[str, list[_Submitted]] = {}
        for job in self._submitted():
            if any(
                read_end(self._out / task.name) is None for tasks in job.elements for task in tasks
            ):
                waiting.setdefault(job.scheduler, []).append(job)
        found: dict[str, str] = {}
        for name, jobs in waiting.items():
            if is_reference(name) and name != scheduler:
                tasks = (task for job in jobs for element in job.elements for task in element)
                found |= dict.fromkeys((task.name for task in tasks), "submitted")
                continue
            states = make_scheduler(name).states([job.name for job in jobs])
            for job in jobs:
                for index, state in states.get(job.name, {}).items():
                    element = job.elements[index : index + 1]
                    found |= dict.fromkeys((task.name for task in chain(*element)), state)
        # Ends are read after the states: an element that has left the queue has written its own.
        return {name: state for name, state in found.items() if not read_end(self._out / name)}

    def submit(self, tasks: Sequence[Task], submission: Submission) -> list[str]:
        """Submit tasks and return a line about each array.

        Raises
        ------
        BadInput
            If the scheduler refuses an array, or does not answer. The arrays before it are
            submitted; those after it are for the next call.
        """
        scheduler = make_scheduler(submission.scheduler)
        size = submission.chunk
        elements = [tasks[i : i + size] for i in range(0, len(tasks), size)]
        largest = scheduler.largest_array()
        lines = []
        self.path.mkdir(exist_ok=True)
        for start in range(0, len(elements), largest):
            part = elements[start : start + largest]
            name = f"fem-snh-{secrets.token_hex(4)}"
            data = self.path / f"{name}.json"
            script = data.with_suffix(".sh")
            record = {
                "scheduler": submission.scheduler,
                "command": list(submission.command),
                "folder": os.getcwd(),
                "elements": [[task.data() for task in tasks] for tasks in part],
            }
            words = shlex.join([*python(_MODULE), str(data.resolve())])
            words = words.replace("{", "{{").replace("}", "}}")
            array = Array(
                name, len(part), max(task.ranks for tasks in part for task in tasks),
                self.path.resolve(), f"{words} {{index}}",
                _largest_sum(part), max(t.memory or 0 for ts in part for t in ts) or None,
            )  # fmt: skip
            replace_file(script, scheduler.script(array, submission))
            # Before it is submitted: a job that nobody remembers would run points twice.
            replace_file(data, json.dumps(record))
            try:
                number = scheduler.submit(script)
            except BadInput:
                if name not in scheduler.states([name]):  # raises if it does not answer: kept
                    remove(data)
                    remove(script)
                raise
            points = sum(map(len, part))
            lines.append(
                f"submitted {points} points: {len(part)} elements of job {number} ({name})"
            )
        return lines

    def command(self) -> tuple[Path, list[str]]:
        """Return the folder and the arguments of the command that has submitted points last.

        Raises
        ------
        BadInput
            If no command has.
        """
        newest = max(self._submitted(), key=lambda job: self._time(job.name), default=None)
        if newest is None or not newest.command or not Path(newest.folder).is_dir():
            raise BadInput(
                f"out = {self._out}: expected a study that a command with --scheduler has submitted"
            )
        return Path(newest.folder), newest.command

    def status(self, name: str, scheduler: str | None = None) -> Counter[str]:
        """Return the number of points by state, with those that have a row or have ended.

        Parameters
        ----------
        name : str
            Name of the study.
        scheduler : str, optional
            As in `queued`.
        """
        try:
            points = list(json.loads(read_text(self._out / f"{name}.json"))["points"])
            table = read_text(self._out / f"{name}.csv").splitlines()[1:]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            raise BadInput(f"out = {self._out}: expected the folder of a {name} study") from None
        rows = {line.partition(",")[0].strip('"') for line in table}
        queued = self.queued(scheduler)
        count: Counter[str] = Counter({"points": len(points), "in the table": 0})
        for point in points:
            if point in rows:
                count["in the table"] += 1
            elif read_end(self._out / point):
                count["ended"] += 1
            else:
                count[queued.get(point, "not in the queue")] += 1
        return count

    def clear(self) -> None:
        """Remove the files of jobs that have ended."""
        for job in self._submitted():
            for file in self.path.glob(f"{job.name}*"):
                remove(file)

    def _submitted(self) -> Iterator[_Submitted]:
        """Yield what has been submitted."""
        for file in sorted(self.path.glob("fem-snh-*.json")):
            yield _read(file)

    def _time(self, name: str) -> int:
        return (self.path / f"{name}.json").stat().st_mtime_ns


def read_element(file: Path, index: int) -> list[Task]:
    """Return the tasks of an element of an array."""
    return _read(file).elements[index]


def _read(file: Path) -> _Submitted:
    """Return the content of NAME.json; raise BadInput if it is damaged."""
    try:
        found = TypeAdapter(_Submitted).validate_json(read_text(file))
    except (OSError, ValueError):
        raise BadInput(
            f"{file} is damaged: expected the points of a job: remove it if none is in the queue"
        ) from None
    return replace(found, name=file.stem)


def _largest_sum(elements: Sequence[Sequence[Task]]) -> float | None:
    """Return the largest sum of the timeouts of an element; None if a task has none [s]."""
    timeouts = [[task.timeout for task in tasks] for tasks in elements]
    if any(timeout is None for element in timeouts for timeout in element):
        return None
    return max(sum(timeout or 0 for timeout in element) for element in timeouts)
