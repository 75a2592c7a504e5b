"""Run the points of a study on this machine, or submit them to a scheduler.

The folder ``jobs`` of a study holds for each array NAME.json (the tasks of its elements), NAME.sh
(its script) and the output of its elements. An element runs its tasks one after another, as the
study does on its own machine: ``python -m fem_snh.studies.jobs FILE.json INDEX``. That a point has
ended is known from the file in its own folder alone; the scheduler is asked only for points that
wait or run. Hence nothing depends on the files of the scheduler, and a point whose job was lost is
one that has neither ended nor is in the queue.
"""

from __future__ import annotations

import json
import os
import secrets
import shlex
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

from pydantic import TypeAdapter

from fem_snh.errors import BadInput
from fem_snh.files import read_text, remove, replace_file
from fem_snh.processes import Interrupts, python
from fem_snh.records.run_files import remove_run
from fem_snh.references import is_reference
from fem_snh.studies.processes import Worker
from fem_snh.studies.schedulers import Array, Submission, make_scheduler

#: The log of a point, and how it ended (`End`).
LOG, END = "log.txt", "end.json"
#: Seconds between two polls of the running points.
_POLL_INTERVAL = 0.005


@dataclass(frozen=True)
class Task:
    """The arguments of ``fem-snh`` for a point, and its limits.

    Parameters
    ----------
    name : str
        Name of the point, and of its folder.
    arguments : tuple of str
        The arguments.
    ranks : int
        MPI ranks.
    timeout, memory : float, optional
        Limits [s, GiB].
    """

    name: str
    arguments: tuple[str, ...]
    ranks: int
    timeout: float | None = None
    memory: float | None = None


@dataclass(frozen=True)
class End:
    """How a task ended.

    Parameters
    ----------
    code : int
        Exit code; negative: a signal.
    seconds : float
        Running time.
    limit : str
        The limit that ended it; "" otherwise.
    """

    code: int = 0
    seconds: float = 0.0
    limit: str = ""


def read_end(folder: Path) -> End | None:
    """Return the end of the point in a folder; None if it has not ended."""
    try:
        return End(**json.loads(read_text(folder / END)))
    except (OSError, ValueError, TypeError):
        return None


def remove_point(out: Path, name: str) -> None:
    """Remove the files of a point, and its folder unless it holds others.

    Raises BadInput if a process still writes into it.
    """
    folder = out / name
    if Path(name).name != name or not folder.is_dir() or folder.is_symlink():
        return  # a name that was edited, or a point that has not run
    for file in (LOG, END):
        remove(folder / file)
    remove_run(folder)


def run_tasks(
    out: Path, tasks: Iterable[Task], number: int, report: Callable[[Task, End], None]
) -> None:
    """Run tasks in processes of this machine, ``number`` at a time, and report each that ends.

    A task has the folder of its name in ``out``, from which an earlier attempt is removed.
    """
    waiting, idle = list(tasks), list[Worker]()
    running: dict[Task, Worker] = {}
    with Interrupts() as interrupts:
        try:
            while waiting or running:
                with interrupts.postponed():  # an interrupt here would lose a new process
                    while waiting and len(running) < number:
                        task = waiting.pop(0)
                        remove_point(out, task.name)
                        (log := out / task.name / LOG).parent.mkdir(exist_ok=True)
                        worker = running[task] = idle.pop() if idle else Worker(task.ranks)
                        worker.start(task.arguments, log, task.timeout, task.memory)
                    for task, worker in list(running.items()):
                        if (code := worker.poll()) is not None:
                            del running[task]
                            if waiting and worker.idle:
                                idle.append(worker)
                            else:
                                worker.close()
                            end = End(code, worker.seconds, worker.limit_reached)
                            replace_file(out / task.name / END, json.dumps(asdict(end)))
                            report(task, end)
                time.sleep(_POLL_INTERVAL)
        finally:
            for worker in (*running.values(), *idle):
                worker.end()


@dataclass(frozen=True)
class _Submitted:
    """The content of NAME.json."""

    scheduler: str
    command: list[str]
    folder: str
    elements: list[list[Task]]


class Jobs:
    """The jobs of a study.

    Parameters
    ----------
    out : Path
        The folder of the study.
    """

    def __init__(self, out: Path) -> None:
        self._out, self.path = out, out / "jobs"

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
        waiting: dict[str, dict[str, _Submitted]] = {}
        for name, job in self._submitted().items():
            if any(not read_end(self._out / task.name) for task in chain(*job.elements)):
                waiting.setdefault(job.scheduler, {})[name] = job
        found: dict[str, str] = {}
        for kind, jobs in waiting.items():
            states: Mapping[str, Mapping[int, str]]
            if is_reference(kind) and kind != scheduler:
                states = {n: dict.fromkeys(range(len(j.elements)), "submitted")
                          for n, j in jobs.items()}  # fmt: skip
            else:
                states = make_scheduler(kind).states(list(jobs))
            for name, job in jobs.items():
                for index, state in states.get(name, {}).items():
                    for task in chain(*job.elements[index : index + 1]):
                        found[task.name] = state
        # Ends are read after the states: an element that has left the queue has written its own.
        return {name: state for name, state in found.items() if not read_end(self._out / name)}

    def submit(self, tasks: Sequence[Task], submission: Submission) -> list[str]:
        """Submit tasks, whose limits are the same, and return a line about each array.

        Raises
        ------
        BadInput
            If the scheduler refuses an array, or does not answer. The arrays before it are
            submitted; those after it are for the next call.
        """
        scheduler = make_scheduler(submission.scheduler)
        size, limits = submission.chunk, tasks[0]
        elements = [list(tasks[i : i + size]) for i in range(0, len(tasks), size)]
        largest = scheduler.largest_array()
        lines = []
        self.path.mkdir(exist_ok=True)
        for start in range(0, len(elements), largest):
            part = elements[start : start + largest]
            name = f"fem-snh-{secrets.token_hex(4)}"
            data, script = self.path / f"{name}.json", self.path / f"{name}.sh"
            job = _Submitted(submission.scheduler, list(submission.command), os.getcwd(), part)
            words = shlex.join([*python("fem_snh.studies.jobs"), str(data.resolve())])
            words = words.replace("{", "{{").replace("}", "}}")
            array = Array(
                name, len(part), limits.ranks, self.path.resolve(), f"{words} {{index}}",
                limits.timeout and limits.timeout * max(map(len, part)), limits.memory,
            )  # fmt: skip
            replace_file(script, scheduler.script(array, submission))
            # Before it is submitted: a job that nobody remembers would run points twice.
            replace_file(data, json.dumps(asdict(job)))
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
        jobs = self._submitted()
        newest = max(jobs, key=lambda n: (self.path / f"{n}.json").stat().st_mtime_ns, default="")
        job = jobs.get(newest)
        if job is None or not job.command or not Path(job.folder).is_dir():
            raise BadInput(
                f"out = {self._out}: expected a study that a command with --scheduler has submitted"
            )
        return Path(job.folder), job.command

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
        states = self.queued(scheduler)
        states |= {point: "ended" for point in points if read_end(self._out / point)}
        states |= {line.partition(",")[0].strip('"'): "in the table" for line in table}
        count: Counter[str] = Counter({"points": len(points), "in the table": 0})
        count.update(states.get(point, "not in the queue") for point in points)
        return count

    def clear(self) -> None:
        """Remove the files of jobs that have ended."""
        for name in self._submitted():
            for file in self.path.glob(f"{name}*"):
                remove(file)

    def _submitted(self) -> dict[str, _Submitted]:
        """Return what has been submitted, by the names of the arrays."""
        return {file.stem: _read(file) for file in sorted(self.path.glob("fem-snh-*.json"))}


def _read(file: Path) -> _Submitted:
    """Return the content of NAME.json; raise BadInput if it is damaged."""
    try:
        return TypeAdapter(_Submitted).validate_json(read_text(file))
    except (OSError, ValueError):
        raise BadInput(
            f"{file} is damaged: expected the points of a job: remove it if none is in the queue"
        ) from None


def main(file: str, index: str) -> int:
    """Run the tasks of an element of an array that have not ended; return 0.

    A scheduler may start an element a second time.
    """
    out = Path(file).parents[1]
    tasks = _read(Path(file)).elements[int(index)]

    def report(task: Task, end: End) -> None:
        print(f"{task.name}: exit code {end.code}, {end.seconds:.1f} s {end.limit}", flush=True)

    run_tasks(out, [task for task in tasks if read_end(out / task.name) is None], 1, report)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
