"""Functions called in a new process, MPI launchers, and interruptions of this process.

A library that crashes in a new process does not end the program: gmsh and VTK can crash, hang at a
prompt or print when they read a damaged file. This module imports only the standard library and
fem_snh.errors; the new process also imports the function's module.
"""

from __future__ import annotations

import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryFile
from threading import TIMEOUT_MAX
from typing import Any, TypeVar

from fem_snh.errors import BadInput

T = TypeVar("T")

#: The end of the message of `Crashed`.
UNDAMAGED = ": expected undamaged input"
#: The kinds of messages from the process of a `call`.
_PROGRESS, _RESULT, _ERROR = "progress", "result", "error"

#: Prefixes of the variables by which an MPI launcher tells a process that it is a rank: those of
#: Open MPI, PMIx, PRRTE, and of MPICH's Hydra.
_LAUNCHER = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDI_", "HYDRA_")
#: Variables that tell a process its rank (Open MPI, PMIx, MPICH), and the number of ranks.
RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")
_SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
#: The user's permission for Open MPI to run as root.
RUN_AS_ROOT = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")


class Crashed(BadInput):
    """The process of a `call` has crashed or hung."""


def call(
    library: str,
    function: Callable[..., T] | str,
    *args: Any,
    report: Callable[..., None] | None = None,
    timeout: float = TIMEOUT_MAX,
    prefix: Sequence[str] = (),
    variables: Mapping[str, str] | None = None,
) -> T:
    """Return ``function(*args)``, called in a new process.

    The process has no input, no output and no variables of an MPI launcher. The function is
    imported by its name; it must not initialise MPI.

    Parameters
    ----------
    library : str
        The library that could crash, for the message.
    function : callable or str
        A function of a module of this package, or the text ``module:function`` if this process is
        not to import the module.
    *args : Any
        The function's arguments. Arguments and result must be picklable.
    report : callable, optional
        If given, the function gets a keyword argument ``report`` whose calls are forwarded to this
        one, in this process.
    timeout : float
        Seconds after which the process counts as hung.
    prefix : sequence of str
        A command that starts the process, such as a launcher.
    variables : mapping, optional
        Environment variables beside those of this process.

    Raises
    ------
    Crashed
        If the process crashes or hangs.
    Exception
        The exception that the function raises.
    """
    if not isinstance(function, str):
        function = f"{function.__module__}:{function.__qualname__}"
    environment = _environment() | dict(variables or {})
    # A pipe to a process that dies early would raise SIGPIPE, which PETSc reports as an error.
    with TemporaryFile() as request:
        pickle.dump((function, args, report is not None), request, 5)
        request.seek(0)
        process = subprocess.Popen(
            [*prefix, *python(__name__)], stdin=request, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, env=environment,
        )  # fmt: skip
    assert process.stdout
    timer = threading.Timer(timeout, process.kill)
    timer.daemon = True
    timer.start()
    try:
        with process.stdout:
            while (message := pickle.load(process.stdout))[0] == _PROGRESS:
                if report:
                    report(*message[1])
    except (EOFError, pickle.UnpicklingError):  # it ended early; its exit code says how
        process.wait()
        ending = _ending(process.returncode) if timer.is_alive() else "hung"
        raise Crashed(f"{library} {ending}{UNDAMAGED}") from None
    except BaseException:  # a keyboard interrupt
        process.kill()
        raise
    finally:
        timer.cancel()
        process.wait()
    kind, value = message
    if kind == _ERROR:
        raise value
    result: T = value
    return result


def python(module: str) -> list[str]:
    """Return the command that runs a module, in an environment with `import_path`.

    Python alone would import from the working directory first, where a user may have put any file.
    """
    return [sys.executable, "-P", "-m", module]


def import_path() -> dict[str, str]:
    """Return {"PYTHONPATH": ...} for a child that imports from where this process does."""
    package = str(Path(__file__).resolve().parents[1])
    paths = dict.fromkeys([*(path for path in sys.path if path), package])
    return {"PYTHONPATH": os.pathsep.join(paths)}


def is_rank() -> bool:
    """Return whether an MPI launcher has started this process."""
    return any(name in os.environ for name in (*RANK_VARIABLES, *_SIZES))


def without_launcher(variables: Mapping[str, str], kept: Collection[str] = ()) -> dict[str, str]:
    """Return environment variables without those of an MPI launcher, except ``kept``.

    A child that inherits the launcher's takes itself for the same rank, and hangs.
    """
    return {k: v for k, v in variables.items() if not k.startswith(_LAUNCHER) or k in kept}


def _environment() -> dict[str, str]:
    """Return the environment of the process of a `call`."""
    return without_launcher(os.environ) | import_path() | {"OPENBLAS_NUM_THREADS": "1"}


def _ending(code: int) -> str:
    """Return how a process with this return code ended, in words."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"crashed ({signal.Signals(-code).name})"
    except ValueError:  # a real-time signal
        return f"crashed (signal {-code})"


class Interrupts:
    """A context in which SIGINT and SIGTERM raise KeyboardInterrupt.

    The previous handlers are restored at its end. In a thread other than the main thread, Python
    allows no handlers, so the context does nothing there.

    Parameters
    ----------
    delay : float
        Seconds between the signal and the exception. Ranks other than 0 use it: while they
        continue, the MPI calls of rank 0 return, and rank 0 can write the status of the run.

    Notes
    -----
    When mpirun is interrupted it sends SIGTERM to all ranks, and SIGKILL a second later. Open MPI
    6 sends SIGKILL alone, after which the status of the run remains ``running``.

    `postponed` does not use a signal mask, as another thread of the process may receive the signal.
    """

    def __init__(self, delay: float = 0.0) -> None:
        self._delay = delay
        self._postponed = self._received = False
        self._previous: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        signals = [signal.SIGINT, signal.SIGTERM, *([signal.SIGALRM] if self._delay else [])]
        if threading.current_thread() is threading.main_thread():
            self._previous = {number: signal.signal(number, self._interrupt) for number in signals}
        return self

    def __exit__(self, *_: Any) -> None:
        if self._delay:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _interrupt(self, number: int, _: Any) -> None:
        """Handle a signal: start the timer of the delay, or raise KeyboardInterrupt, once.

        Further signals are ignored: the run is ending already and writes its status, and a Python
        handler would disturb the exception on its way through PETSc.
        """
        if self._delay and number != signal.SIGALRM:
            signal.setitimer(signal.ITIMER_REAL, self._delay)
            return
        self._received = True
        for known in self._previous:
            signal.signal(known, signal.SIG_IGN)
        if not self._postponed:
            raise KeyboardInterrupt

    @contextmanager
    def postponed(self) -> Iterator[None]:
        """Postpone KeyboardInterrupt until the end of this context."""
        self._postponed = True
        try:
            yield
        finally:
            self._postponed = False
        if self._received:
            raise KeyboardInterrupt


def _serve() -> None:
    """Call the function that standard input names, and write its outcome to standard output."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # no core file in the user's folder
    function, args, reports = pickle.load(sys.stdin.buffer)
    # Libraries read standard input for prompts and print to standard output.
    result = os.fdopen(os.dup(1), "wb")
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)
    os.dup2(null, 1)

    def send(kind: str, value: Any) -> None:
        pickle.dump((kind, value), result, 5)
        result.flush()

    keywords = {"report": lambda *values: send(_PROGRESS, values)} if reports else {}
    module, _, name = function.partition(":")
    try:
        send(_RESULT, getattr(import_module(module), name)(*args, **keywords))
    except Exception as error:
        send(_ERROR, error)
    os._exit(0)  # without a library's destructors, which can crash after a damaged file


if __name__ == "__main__":
    _serve()
