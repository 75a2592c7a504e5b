"""Processes that run points of a study one after another, which spares each its imports and MPI."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from fem_snh.studies.processes import Child, program

#: The module that a worker runs.
_MODULE = "fem_snh.cli.worker"
#: What precedes the exit code of a point in a worker's answer.
ANSWER = b"fem-snh: exit code "
#: Seconds for which a worker without a point may finalise MPI before it is ended.
_TIME_TO_END = 5.0
#: Bytes of messages that are kept.
_MAX_MESSAGES = 100_000


class Worker(Child):
    """A process, or the ranks of one MPI job, for one point after another.

    To its caller it is the `Child` of its present point: `poll` returns the exit code of that
    point, and the limits hold for that point. A point that crashes or reaches a limit ends the
    worker; the next point needs another one.

    Parameters
    ----------
    ranks : int
        MPI ranks of each point.
    """

    def __init__(self, ranks: int) -> None:
        self._messages = tempfile.TemporaryFile()  # of mpirun, and of a start that fails
        pipe = subprocess.PIPE
        self._launch(program(ranks, _MODULE), None, pipe, pipe, self._messages)
        self._set_limits(None, None)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._points, self._answers = self._process.stdin, self._process.stdout
        os.set_blocking(self._answers.fileno(), False)
        self._log: Path | None = None
        self._code: int | None = None

    def start(
        self, arguments: Sequence[str], log: Path, timeout: float | None, memory: float | None
    ) -> None:
        """Start a point: see `Child`. The worker must be `idle`, or new."""
        self._log, self._code = log, None
        log.touch()
        self._set_limits(timeout, memory)
        point = {"arguments": list(arguments), "log": str(log.resolve())}
        with suppress(BrokenPipeError):  # it has ended: `poll` returns its exit code
            self._points.write(json.dumps(point).encode() + b"\n")
            self._points.flush()

    @property
    def idle(self) -> bool:
        """Whether its point has converged and the process waits for the next one."""
        return self._code == 0 and self._process.poll() is None

    def poll(self) -> int | None:
        """Return the exit code of the present point, or None while it runs; enforce the limits."""
        if self._code is None:
            ended = super().poll()  # before reading: a process that has ended writes no more
            self._code = self._answer()
            if self._code is None and ended is not None:
                self._code = ended
                self._keep_messages()
        return self._code

    def close(self) -> None:
        """Let a worker without a point end, and wait for that."""
        with suppress(BrokenPipeError):
            self._points.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_TIME_TO_END)
        self.end()
        self._files.cleanup()

    def _answer(self) -> int | None:
        """Return the exit code that the worker has written, or None if there is none yet."""
        while line := self._answers.readline():
            if line.startswith(ANSWER):
                return int(line.removeprefix(ANSWER))
        return None

    def _keep_messages(self) -> None:
        """Append what mpirun or Python has written about a failure to the log of the point."""
        text = os.pread(self._messages.fileno(), _MAX_MESSAGES, 0)
        if self._log:
            with self._log.open("ab") as file:
                file.write(text)
