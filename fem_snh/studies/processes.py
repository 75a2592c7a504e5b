"""Runs in processes of their own: started with a log, ended as a whole with all their ranks."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fem_snh.errors import BadInput

# Open MPI: jobs side by side must not be bound to the same cores, and a laptop may oversubscribe.
_SHARING = {
    "OMP_NUM_THREADS": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_hwloc_default_binding_policy": "none",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}
_ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
_GRACE = 5.0  # seconds between the request to end and the end
_LOOK = 0.25  # seconds between two looks at the memory


def environment() -> dict[str, str]:
    """This process's environment for a child that starts its own MPI.

    If we are a rank ourselves, what our launcher told us is taken out: a child that inherits it
    believes to be our rank, and hangs.
    """
    env = dict(os.environ)
    if _is_rank():
        ours = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDI_", "HYDRA_")
        kept = {*_ROOT, *_SHARING, "OMPI_MCA_btl_vader_single_copy_mechanism"}  # the user's own
        env = {key: v for key, v in env.items() if not key.startswith(ours) or key in kept}
    if os.geteuid() == 0:
        env = _ROOT | env
    return _SHARING | env


def _is_rank() -> bool:
    return any(key in os.environ for key in ("OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK"))


def program(ranks: int, module: str = "fem_snh") -> list[str]:
    """The words that start a module on this many ranks. BadInput without mpirun."""
    python = [sys.executable, "-m", module]
    if ranks == 1:
        return python
    mpirun = shutil.which("mpirun")
    if mpirun is None:
        raise BadInput(f"ranks = {ranks}: there is no mpirun on the PATH; install one, or use 1")
    return [mpirun, "-n", str(ranks), *python]


class Child:
    """A running command whose output goes to a log file, within limits of time and memory.

    Memory [GiB] is what all its processes have in RAM together, looked at a few times a second:
    unlike an rlimit it holds for the ranks that mpirun starts, and for their sum.

    Attributes:
        given_up: which limit ended it, in words; empty if none did.
        seconds: how long it has run, or ran until it was seen to have ended.
    """

    def __init__(
        self,
        command: list[str],
        log: Path,
        timeout: float | None = None,
        memory: float | None = None,
    ) -> None:
        self.timeout, self.memory = timeout, memory
        self.given_up = ""
        self.seconds = 0.0
        self._start = time.monotonic()
        self._looked = 0.0
        # Open MPI's files apart from those of jobs that end or begin just now: they share a folder
        # that the last one removes, and one that begins finds missing.
        self._files = tempfile.TemporaryDirectory(prefix="fem-snh-", ignore_cleanup_errors=True)
        with log.open("w") as file:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=environment() | {"TMPDIR": self._files.name},
                start_new_session=True,
            )
        if _is_rank():  # we are bound to a core or so: our children need not share it
            os.sched_setaffinity(self._process.pid, range(os.cpu_count() or 1))

    def ranks(self) -> list[int]:
        """The ids of its living ranks, the first one's first; a single process is its own rank."""
        told = [(_rank(pid), pid) for pid in _session(self._process.pid)]
        found = sorted((rank, pid) for rank, pid in told if rank is not None)
        return [pid for _, pid in found] or [self._process.pid]

    def signal(self, number: int) -> None:
        """Send a signal to the launcher, or the only process."""
        self._process.send_signal(number)

    def poll(self) -> int | None:
        """The exit code (negative: a signal), or None while it runs; ends it at its limits."""
        code = self._process.poll()
        if code is None or not self.seconds:
            self.seconds = time.monotonic() - self._start
        if code is None and (limit := self._limit()):
            self.given_up = limit
            self.end()
            code = self._process.wait()
        if code is not None:
            self._files.cleanup()
        return code

    def _limit(self) -> str:
        """The limit that it has reached, in words, or nothing."""
        if self.timeout and self.seconds > self.timeout:
            return f"given up after {self.timeout:g} s"
        if self.memory and self.seconds > self._looked + _LOOK:
            self._looked = self.seconds
            if _resident(self._process.pid) > self.memory:
                return f"given up above {self.memory:g} GiB"
        return ""

    def end(self) -> None:
        """Ask, wait a little, then kill: the launcher and every rank it started."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_GRACE)
            except subprocess.TimeoutExpired:
                pass
        late = time.monotonic() + _GRACE
        while (left := _session(self._process.pid)) and time.monotonic() < late:
            for pid in left:
                try:
                    os.kill(pid, signal.SIGKILL)
                except ProcessLookupError:
                    pass
            time.sleep(0.01)
        self._process.wait()


def _resident(leader: int) -> float:
    """What the processes of a session have in RAM [GiB], pages that they share counted for each."""
    pages = 0
    for pid in _session(leader):
        try:
            pages += int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        except (OSError, IndexError):
            continue  # it has just ended
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**30


def _rank(pid: int) -> int | None:
    """Which rank a process is, by what its launcher told it."""
    try:
        told = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError:
        return None  # it has just ended
    for key in (b"OMPI_COMM_WORLD_RANK=", b"PMIX_RANK=", b"PMI_RANK="):
        for word in told:
            if word.startswith(key):
                return int(word.removeprefix(key))
    return None


def _session(leader: int) -> list[int]:
    """The living processes of a session: mpirun gives its ranks groups of their own, but in it."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue  # it has just ended
        if int(session) == leader and state not in "ZX":
            found.append(int(stat.parent.name))
    return found
