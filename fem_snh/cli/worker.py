"""A process that solves points of a study one after another: ``python -m fem_snh.cli.worker``.

`fem_snh.studies.processes` starts it, on any number of ranks. It reads a line of JSON per point,
``{"arguments": [...], "log": path}``, solves it as ``fem-snh`` with these arguments would, and
writes its exit code as a line. It ends after the first point that fails, as that may leave memory
or MPI in any state, and at the end of its input.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
from contextlib import suppress
from pathlib import Path

from mpi4py import MPI

from fem_snh.cli import main as run_command
from fem_snh.studies.processes import ANSWER


def main() -> int:
    """Run points until the input ends or one of them fails; return the last exit code."""
    comm = MPI.COMM_WORLD
    answers = os.dup(1)
    with open(os.dup(0)) as points:
        while True:
            line = comm.bcast(points.readline() if comm.rank == 0 else None)
            if not line:
                return 0
            point = json.loads(line)
            _write_to(point["log"])
            _reset_peak_memory()
            code = comm.allreduce(run_command(point["arguments"]), MPI.MAX)
            _flush()
            if comm.rank == 0:
                os.write(answers, ANSWER + f"{code}\n".encode())
            if code:
                return int(code)


def _write_to(log: str) -> None:
    """Redirect standard output and error to a file, which C code of libraries writes to as well."""
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    os.dup2(file, 1)
    os.dup2(file, 2)
    os.close(file)


def _flush() -> None:
    """Write what Python and C libraries have buffered to the log of the point."""
    sys.stdout.flush()
    ctypes.CDLL(None).fflush(None)


def _reset_peak_memory() -> None:
    """Make the peak of the resident memory that of the next point (proc(5), clear_refs)."""
    with suppress(OSError):  # a kernel without it: the peak is then that of all points so far
        Path("/proc/self/clear_refs").write_text("5")


if __name__ == "__main__":
    sys.exit(main())
