"""Faults of the operating system: a killed rank, a full disk, a termination signal."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from benchmarks import Row
from benchmarks.faults.intervention import CONVERGED_STEPS
from benchmarks.faults.pause import RESUME
from benchmarks.faults.trial import Trial, resume_and_compare
from fem_snh.processes import RANK_VARIABLES
from fem_snh.studies.tasks import Child

#: Limit on the size of a file [B]: between a checkpoint (30 KiB) and the fields of a step (42 KiB).
_FILE_SIZE = 40 * 1024
_MOUNT = ("mount", "-t", "tmpfs", "-o")


def killed_rank(folder: Path) -> Row:
    """Send SIGKILL to one of two ranks: mpirun ends the other."""
    trial = Trial(folder)
    child = trial.start_paused(2)
    os.kill(_ranks(child)[1], signal.SIGKILL)
    code = trial.wait(child)
    return resume_and_compare(trial, code, "signal 9", CONVERGED_STEPS, 1)


def terminated(folder: Path) -> Row:
    """Send SIGTERM to both ranks, as batch systems do, and mpirun up to Open MPI 5 at Ctrl-C."""
    trial = Trial(folder)
    child = trial.start_paused(2)
    for rank in _ranks(child):
        os.kill(rank, signal.SIGTERM)
    code = trial.wait(child)
    return resume_and_compare(trial, code, "interrupted", CONVERGED_STEPS, 1)


def full_disk(folder: Path) -> Row:
    """Write to a disk of 400 KiB, which is enlarged before the run is resumed.

    Where no disk can be mounted, a limit on the size of files takes its place.
    """
    with _temporary_disk("400k") as disk:
        if disk is None:
            return file_size_limit(folder)
        trial = Trial(folder, disk / "run")
        code = trial.wait(trial.start(2))
        subprocess.run([*_MOUNT, "remount,size=16m", "tmpfs", str(disk)], check=True)
        return resume_and_compare(trial, code, "No space left on device", 1, 2)


def file_size_limit(folder: Path) -> Row:
    """Limit files to 40 KiB from one step on: the fields of a step are larger."""
    trial = Trial(folder)
    child = trial.start_paused(1)
    resource.prlimit(_ranks(child)[0], resource.RLIMIT_FSIZE, (_FILE_SIZE, _FILE_SIZE))
    os.kill(_ranks(child)[0], RESUME)
    code = trial.wait(child)
    return resume_and_compare(trial, code, "File too large", CONVERGED_STEPS, 1)


def _ranks(child: Child) -> list[int]:
    """Return the process ids of the running MPI ranks of a child, rank 0 first.

    A process that mpirun has not started counts as its own only rank.
    """
    numbered = []
    for process in child.processes():
        with suppress(psutil.Error):  # it has just ended
            variables = process.environ()
            values = [variables[key] for key in RANK_VARIABLES if key in variables]
            numbered += [(int(values[0]), process.pid)] if values else []
    return [pid for _, pid in sorted(numbered)] or [child.process.pid]


@contextmanager
def _temporary_disk(size: str) -> Iterator[Path | None]:
    """Mount a tmpfs of this size; None without permission to mount.

    It is not mounted inside the study's folder: after a SIGKILL the mount stays, and that folder
    could not be emptied.
    """
    with tempfile.TemporaryDirectory(prefix="fem-snh-disk-") as path:
        done = subprocess.run([*_MOUNT, f"size={size}", "tmpfs", path], capture_output=True)
        if done.returncode != 0:
            yield None
            return
        try:
            yield Path(path)
        finally:
            subprocess.run(["umount", path], check=True)
