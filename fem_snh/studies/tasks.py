"""What the process that runs a point needs to know, and what remains of it: both fit into JSON.

`fem_snh.studies.batch` makes a `Task` of each point. `TaskRunner` runs tasks on this machine, be it
the one of the study or a node of a cluster (`fem_snh.studies.array_element`).
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fem_snh.files import read_text, replace_file
from fem_snh.studies.folder import END, LOG
from fem_snh.studies.processes import Child, program
from fem_snh.studies.workers import Worker


@dataclass(frozen=True)
class Task:
    """The command of a point and its limits.

    Parameters
    ----------
    name : str
        Name of the point, and of its folder.
    module : str
        The module that is run.
    arguments : tuple of str
        Its arguments.
    ranks : int
        MPI ranks.
    timeout, memory : float, optional
        Limits [s, GiB].
    """

    name: str
    module: str
    arguments: tuple[str, ...]
    ranks: int
    timeout: float | None = None
    memory: float | None = None

    def data(self) -> dict[str, Any]:
        """Return the task as JSON accepts it; the keywords of a `Task`."""
        return asdict(self)


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

    def write(self, folder: Path) -> None:
        """Write it into the folder of the point, as a whole or not at all."""
        replace_file(folder / END, json.dumps(asdict(self)))


def read_end(folder: Path) -> End | None:
    """Return the end of the point in a folder; None if it has not ended."""
    try:
        return End(**json.loads(read_text(folder / END)))
    except (OSError, ValueError, TypeError):
        return None


class TaskRunner:
    """Start tasks in child processes of this machine: commands of ``fem-snh`` in idle workers."""

    def __init__(self) -> None:
        self._idle: list[Worker] = []

    def start(self, task: Task, folder: Path) -> Child:
        """Start a task whose log is in ``folder``."""
        limits = task.timeout, task.memory
        if task.module != "fem_snh":
            return Child(
                [*program(task.ranks, task.module), *task.arguments], folder / LOG, *limits
            )
        worker = self._idle.pop() if self._idle else Worker(task.ranks)
        worker.start(task.arguments, folder / LOG, *limits)
        return worker

    def keep_or_close(self, child: Child, wanted: bool) -> None:
        """Keep the worker of a point that has ended for another one, if that is ``wanted``."""
        if isinstance(child, Worker):
            if wanted and child.idle:
                self._idle.append(child)
            else:
                child.close()

    def close(self) -> None:
        """End the idle processes."""
        for worker in self._idle:
            worker.end()
