"""What the system does to a run: a rank killed, the disk full, a signal in the middle of a step."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fem_snh.studies.extremes.faults.disturbed import DONE
from fem_snh.studies.extremes.faults.holding import GO
from fem_snh.studies.extremes.faults.trial import Trial, verdict

_SMALL = 40 * 1024  # [B] of the fields' 51, and of the checkpoint's 30
_MOUNT = ("mount", "-t", "tmpfs", "-o")


def killed_rank(folder: Path) -> dict[str, Any]:
    """SIGKILL to one of two ranks: mpirun ends the other."""
    trial = Trial(folder)
    child = trial.held(2)
    os.kill(child.ranks()[1], signal.SIGKILL)
    code = trial.wait(child)
    return verdict(trial, code, "signal 9", DONE, 1)


def terminated(folder: Path) -> dict[str, Any]:
    """SIGTERM to mpirun, which gives its ranks a second; as after Ctrl-C."""
    trial = Trial(folder)
    child = trial.held(2)
    child.signal(signal.SIGTERM)
    code = trial.wait(child)
    return verdict(trial, code, "interrupted", DONE, 1)


def full_disk(folder: Path) -> dict[str, Any]:
    """A disk of 400 KiB; it gets larger before the run is resumed.

    Where none may be mounted, it is files that may not be large.
    """
    with _disk("400k") as disk:
        if disk is None:
            return file_cut_short(folder)
        trial = Trial(folder, disk / "run")
        code = trial.wait(trial.start(2))
        subprocess.run([*_MOUNT, "remount,size=16m", "tmpfs", str(disk)], check=True)
        return verdict(trial, code, "No space left on device", 1, 2)


def file_cut_short(folder: Path) -> dict[str, Any]:
    """From some step on no file may be larger than 40 KiB, which the fields of a step are."""
    trial = Trial(folder)
    child = trial.held(1)
    resource.prlimit(child.ranks()[0], resource.RLIMIT_FSIZE, (_SMALL, _SMALL))
    os.kill(child.ranks()[0], GO)
    code = trial.wait(child)
    return verdict(trial, code, "File too large", DONE, 1)


@contextmanager
def _disk(size: str) -> Iterator[Path | None]:
    """A disk of its own of this size; None if there may be none.

    Not in a study's folder: killed in here, it leaves its disk mounted, and that folder could not
    be emptied for the next attempt.
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
