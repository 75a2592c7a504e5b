"""Child processes of studies: their environment, their limits, and their end with all MPI ranks.

`run_tasks` runs the points of a study.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import psutil

from fem_snh.errors import BadInput
from fem_snh.files import read_text, remove, replace_file
from fem_snh.processes import (
    RUN_AS_ROOT,
    Interrupts,
    import_path,
    is_rank,
    python,
    without_launcher,
)
from fem_snh.records.run_files import remove_run

# Open MPI: jobs side by side must not be bound to the same cores, and a laptop may oversubscribe.
# Version 4 reads the variables of OMPI, 5 those of PRTE, 6 the last two of these.
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
#: Files of a point: its log, and how it ended (`End`).
LOG, END = "log.txt", "end.json"
#: Seconds between two polls of the running points.
_POLL_INTERVAL = 0.005


def environment() -> dict[str, str]:
    """Return this process's environment for a child that starts its own MPI.

    If this process is an MPI rank itself, the variables of its launcher are removed.
    """
    env = dict(os.environ)
    if is_rank():
        own = {*RUN_AS_ROOT, *_SHARING, "OMPI_MCA_btl_vader_single_copy_mechanism"}  # the user's
        env = without_launcher(env, own)
    if os.geteuid() == 0:
        env = dict.fromkeys(RUN_AS_ROOT, "1") | env
    return _SHARING | env | import_path()


def program(ranks: int, module: str = "fem_snh") -> list[str]:
    """Return the command that starts a module on ``ranks`` MPI ranks.

    Raises
    ------
    BadInput
        If ``ranks`` is more than 1 and there is no mpirun.
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
        File for standard output and error.
    timeout : float, optional
        Seconds after which the command is ended.
    memory : float, optional
        Resident memory of all processes of the command together above which it is ended [GiB].
        Unlike an rlimit, this includes the ranks that mpirun starts.
    variables : mapping, optional
        Environment variables in addition to those of `environment`.

    Attributes
    ----------
    process : subprocess.Popen
        The launcher, or the only process.
    limit_reached : str
        The limit that ended the command; empty if none did.
    seconds : float
        Running time [s] at the last `poll` that found the command running, or at its end.
    """

    def __init__(
        self,
        command: list[str],
        log: Path,
        timeout: float | None = None,
        memory: float | None = None,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        self.timeout, self.memory = timeout, memory
        self.limit_reached = ""
        self.seconds = self._memory_measured = 0.0
        self._start = time.monotonic()
        # Open MPI keeps its session files in TMPDIR and removes that folder when the last job ends:
        # each child has its own, so that no job removes it while another one starts.
        self._files = tempfile.TemporaryDirectory(prefix="fem-snh-", ignore_cleanup_errors=True)
        # A study that is killed leaves no point behind, which would write into its folder.
        # mpirun has to end its ranks.
        number = signal.SIGKILL if command[0] == sys.executable else signal.SIGTERM
        with log.open("w") as file:
            self.process = subprocess.Popen(
                command,
                env=environment() | {"TMPDIR": self._files.name} | dict(variables or {}),
                start_new_session=True,
                preexec_fn=partial(ctypes.CDLL(None).prctl, _PR_SET_PDEATHSIG, number),
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        if is_rank():  # mpirun may have bound this rank to one core; the child may use them all
            os.sched_setaffinity(self.process.pid, range(os.cpu_count() or 1))

    def poll(self) -> int | None:
        """Return the exit code (negative: a signal), or None while running; enforce the limits."""
        code = self.process.poll()
        if code is None or not self.seconds:
            self.seconds = time.monotonic() - self._start
        if code is None and (limit := self._exceeded_limit()):
            self.limit_reached = limit
            self.end()
            code = self.process.wait()
        if code is not None:
            self._files.cleanup()
        return code

    def _exceeded_limit(self) -> str:
        """Return the limit that is exceeded, as text, or an empty text."""
        if self.timeout and self.seconds > self.timeout:
            return f"given up after {self.timeout:g} s"
        if self.memory and self.seconds > self._memory_measured + _MEMORY_INTERVAL:
            self._memory_measured = self.seconds
            resident = 0  # pages that are shared count for each process
            for process in self.processes():
                with suppress(psutil.Error):  # it has just ended
                    resident += process.memory_info().rss
            if resident / 2**30 > self.memory:
                return f"given up above {self.memory:g} GiB"
        return ""

    def end(self) -> None:
        """Terminate the launcher; after a grace period kill every process of the session."""
        if self.process.poll() is None:
            self.process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(_GRACE)
        deadline = time.monotonic() + _GRACE
        while (remaining := self.processes()) and time.monotonic() < deadline:
            for process in remaining:
                with suppress(psutil.NoSuchProcess):
                    process.kill()
            time.sleep(0.01)
        self.process.wait()

    def processes(self) -> list[psutil.Process]:
        """Return the living processes of the command's session.

        mpirun gives each rank a process group of its own but leaves it in the session, and a rank
        whose parent has died is no longer among the parent's children.
        """
        living = []
        for process in psutil.process_iter():
            # One that has just ended, or belongs to the system, raises an error.
            with suppress(ProcessLookupError, PermissionError, psutil.Error):
                same = os.getsid(process.pid) == self.process.pid
                if same and process.status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD):
                    living.append(process)
        return living


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
        Limits of running time [s] and resident memory [GiB].
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
        Running time [s].
    limit : str
        The limit that ended the task; "" otherwise.
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


def remove_point(folder: Path) -> None:
    """Remove the files of a point, and its folder unless it holds other files.

    Raises BadInput if a process still writes into it.
    """
    if folder.is_dir():
        for file in (LOG, END):
            remove(folder / file)
        remove_run(folder)


def run_tasks(
    out: Path, tasks: Iterable[Task], number: int, report: Callable[[Task, End], None]
) -> None:
    """Run tasks in processes of this machine, ``number`` at a time, and report each that ends.

    A task runs in ``out/name``, from which an earlier attempt is removed, and its `End` is written
    there. An exception ends the running tasks.
    """
    waiting = list(tasks)
    running: dict[Task, Child] = {}
    with Interrupts() as interrupts:
        try:
            while waiting or running:
                with interrupts.postponed():  # an interrupt here would lose a new process
                    while waiting and len(running) < number:
                        task = waiting.pop(0)
                        remove_point(folder := out / task.name)
                        folder.mkdir(exist_ok=True)
                        command = [*program(task.ranks), *task.arguments]
                        running[task] = Child(command, folder / LOG, task.timeout, task.memory)
                    for task, child in list(running.items()):
                        if (code := child.poll()) is not None:
                            del running[task]
                            end = End(code, child.seconds, child.limit_reached)
                            replace_file(out / task.name / END, json.dumps(asdict(end)))
                            report(task, end)
                time.sleep(_POLL_INTERVAL)
        finally:
            for child in running.values():
                child.end()
