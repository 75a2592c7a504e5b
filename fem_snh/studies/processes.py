"""Start and end the child processes of studies, with a log file and all their MPI ranks."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import IO, Any

import psutil

from fem_snh.errors import BadInput
from fem_snh.processes import (
    RANK_VARIABLES,
    RUN_AS_ROOT,
    import_path,
    is_rank,
    python,
    without_launcher,
)

# Open MPI: jobs side by side must not be bound to the same cores, and a laptop may oversubscribe.
# Version 4 reads the variables of OMPI, 5 those of PRTE, 6 the last two, which it would ask for.
_SHARING = {
    "OMP_NUM_THREADS": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_hwloc_default_binding_policy": "none",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "PRTE_MCA_bindto": "none",
    "PRTE_MCA_mapby": ":oversubscribe",
}
#: Seconds between SIGTERM and SIGKILL.
_GRACE = 5.0
#: prctl(2): the signal that the kernel sends to a process when its parent has ended.
_PR_SET_PDEATHSIG = 1
#: Seconds between two measurements of the memory.
_MEMORY_INTERVAL = 0.25


def environment() -> dict[str, str]:
    """Return this process's environment for a child that starts its own MPI.

    If this process is an MPI rank itself, the variables of its launcher are removed.
    """
    env = dict(os.environ)
    if is_rank():
        kept = {
            *RUN_AS_ROOT,
            *_SHARING,
            "OMPI_MCA_btl_vader_single_copy_mechanism",
        }  # the user's own
        env = without_launcher(env, kept)
    if os.geteuid() == 0:
        env = dict.fromkeys(RUN_AS_ROOT, "1") | env
    return _SHARING | env | import_path()


def program(ranks: int, module: str = "fem_snh") -> list[str]:
    """Return the command that starts a module on ``ranks`` MPI ranks.

    Raises
    ------
    BadInput
        If more than one rank is asked for and there is no mpirun.
    """
    command = python(module)
    if ranks == 1:
        return command
    mpirun = shutil.which("mpirun")
    if mpirun is None:
        raise BadInput(f"ranks = {ranks}: expected 1, as there is no mpirun on the PATH")
    return [mpirun, "-n", str(ranks), *command]


class Child:
    """A running command whose output goes to a log file, within limits of time and memory.

    Parameters
    ----------
    command : list of str
        The command and its arguments.
    log : Path
        File for its standard output and error.
    timeout : float, optional
        Seconds after which it is ended.
    memory : float, optional
        Resident memory of all its processes together above which it is ended [GiB]. Unlike an
        rlimit this holds for the ranks that mpirun starts, and for their sum.
    variables : mapping, optional
        Environment variables in addition to those of `environment`.

    Attributes
    ----------
    limit_reached : str
        The limit that ended it; empty if none did.
    seconds : float
        Running time so far, or until its end was noticed.
    """

    def __init__(
        self,
        command: list[str],
        log: Path,
        timeout: float | None = None,
        memory: float | None = None,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        with log.open("w") as file:
            self._launch(command, variables, subprocess.DEVNULL, file, subprocess.STDOUT)
        self._set_limits(timeout, memory)

    def _set_limits(self, timeout: float | None, memory: float | None) -> None:
        """Set the limits, and count the seconds from now."""
        self.timeout, self.memory = timeout, memory
        self.limit_reached = ""
        self.seconds = 0.0
        self._start = time.monotonic()
        self._memory_measured = 0.0

    def _launch(
        self,
        command: list[str],
        variables: Mapping[str, str] | None,
        stdin: int,
        stdout: IO[Any] | int,
        stderr: IO[Any] | int,
    ) -> None:
        """Start the command with these files."""
        # Open MPI keeps its session files in TMPDIR and removes that folder when the last job ends:
        # each child has its own, so that no job removes it while another one starts.
        self._files = tempfile.TemporaryDirectory(prefix="fem-snh-", ignore_cleanup_errors=True)
        self._process = subprocess.Popen(
            command,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            env=environment() | {"TMPDIR": self._files.name} | dict(variables or {}),
            start_new_session=True,
            # A study that is killed leaves no point behind, which would write into its folder.
            # mpirun has to end its ranks.
            preexec_fn=partial(
                ctypes.CDLL(None).prctl,
                _PR_SET_PDEATHSIG,
                signal.SIGKILL if command[0] == sys.executable else signal.SIGTERM,
            ),
        )
        if is_rank():  # mpirun may have bound this rank to one core; the child may use them all
            os.sched_setaffinity(self._process.pid, range(os.cpu_count() or 1))

    def ranks(self) -> list[int]:
        """Return the process ids of its running MPI ranks, rank 0 first.

        A process that mpirun has not started counts as its own only rank.
        """
        pairs = [(_rank(process), process.pid) for process in self.processes()]
        numbered = sorted((rank, pid) for rank, pid in pairs if rank is not None)
        return [pid for _, pid in numbered] or [self._process.pid]

    def signal(self, number: int) -> None:
        """Send a signal to the launcher, or to the only process."""
        self._process.send_signal(number)

    def poll(self) -> int | None:
        """Return the exit code (negative: a signal), or None while it runs; enforce the limits."""
        code = self._process.poll()
        if code is None or not self.seconds:
            self.seconds = time.monotonic() - self._start
        if code is None and (limit := self._exceeded_limit()):
            self.limit_reached = limit
            self.end()
            code = self._process.wait()
        if code is not None:
            self._files.cleanup()
        return code

    def _exceeded_limit(self) -> str:
        """Return the limit that is exceeded, as text, or an empty text."""
        if self.timeout and self.seconds > self.timeout:
            return f"given up after {self.timeout:g} s"
        if self.memory and self.seconds > self._memory_measured + _MEMORY_INTERVAL:
            self._memory_measured = self.seconds
            if sum(map(_resident, self.processes())) / 2**30 > self.memory:
                return f"given up above {self.memory:g} GiB"
        return ""

    def end(self) -> None:
        """Terminate the launcher; after a grace period kill every process of the session."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_GRACE)
            except subprocess.TimeoutExpired:
                pass
        deadline = time.monotonic() + _GRACE
        while (remaining := self.processes()) and time.monotonic() < deadline:
            for process in remaining:
                try:
                    process.send_signal(signal.SIGKILL)
                except psutil.NoSuchProcess:
                    pass
            time.sleep(0.01)
        self._process.wait()

    def processes(self) -> list[psutil.Process]:
        """Return the living processes of its session.

        mpirun gives each rank a process group of its own but leaves it in the session, and a rank
        whose parent has died is no longer among the parent's children.
        """
        found = []
        for process in psutil.process_iter():
            try:
                same = os.getsid(process.pid) == self._process.pid
                if same and process.status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD):
                    found.append(process)
            except (ProcessLookupError, PermissionError, psutil.Error):
                continue  # it has just ended, or belongs to the system
        return found


def _resident(process: psutil.Process) -> int:
    """Return the resident memory of a process [B]; pages that are shared count for each process."""
    try:
        return int(process.memory_info().rss)
    except psutil.Error:
        return 0  # it has just ended


def _rank(process: psutil.Process) -> int | None:
    """Return the MPI rank of a process from its environment."""
    try:
        variables = process.environ()
    except psutil.Error:
        return None  # it has just ended
    values = [variables[key] for key in RANK_VARIABLES if key in variables]
    return int(values[0]) if values else None
