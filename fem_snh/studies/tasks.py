"""What the process that runs a point needs to know, and what remains of it: both fit into JSON.

`fem_snh.studies.batch` makes a `Task` of each point. `TaskRunner` runs tasks on this machine, be it
the one of the study or a node of a cluster (`fem_snh.studies.array_element`).
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fem_snh.files import read_text, replace_file
from fem_snh.studies.folder import END, LOG
from fem_snh.studies.processes import Child, environment, program
from fem_snh.studies.workers import Worker

#: What the status of a point that is skipped starts with.
NOT_TRIED = "not tried: "


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
    reuse : bool
        Whether the command is one of ``fem-snh``, for which a `Worker` can be used again.
    preparation : tuple of str
        Arguments of ``fem-snh`` that compile what the point needs; nothing is left of them.
    after : str, optional
        The point that has to end before.
    growth : float
        Lower bound of the time over that of ``after``.
    cells : Any
        Its mesh, for the messages about points that come after it.
    """

    name: str
    module: str
    arguments: tuple[str, ...]
    ranks: int
    timeout: float | None = None
    memory: float | None = None
    reuse: bool = False
    preparation: tuple[str, ...] = ()
    after: str | None = None
    growth: float = 1.0
    cells: Any = None

    def data(self) -> dict[str, Any]:
        """Return the task as JSON accepts it; the keywords of a `Task`."""
        return asdict(self)

    def skip_reason(self, coarser: Mapping[str, Any] | None) -> str:
        """Return why the point is skipped, or "".

        Parameters
        ----------
        coarser : mapping, optional
            Of the point ``after``: ``status``, ``seconds`` and ``cells``.
        """
        if coarser is None:
            return ""
        status = str(coarser["status"])
        if status.startswith(NOT_TRIED):  # for the coarsest mesh that failed
            return status
        if status.startswith("given up"):
            return f"{NOT_TRIED}{coarser['cells']} cells were {status}"
        if self.timeout and float(coarser["seconds"] or 0) * self.growth > self.timeout:
            return f"{NOT_TRIED}would take more than {self.timeout:g} s"
        return ""


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
        The limit that ended it, or why it was not tried; "" otherwise.
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
    """Start tasks in child processes of this machine, in idle ones where possible."""

    def __init__(self) -> None:
        self._idle: list[Worker] = []
        self._prepared: set[tuple[str, ...]] = set()

    def start(self, task: Task, folder: Path) -> Child:
        """Start a task whose log is in ``folder``."""
        if task.preparation not in self._prepared and task.preparation:
            self._prepared.add(task.preparation)
            subprocess.run([*program(1), *task.preparation], env=environment(), capture_output=True)
        limits = task.timeout, task.memory
        if not task.reuse:
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
