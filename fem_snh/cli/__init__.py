"""The program ``fem-snh``: dispatch of the commands, error messages and exit codes.

Exit codes: 0 converged, 1 ran but did not converge, 2 bad input or environment (one line on
standard error, from rank 0, never a traceback), 130 interrupted. A command is a function
``name(argv) -> exit code`` of a module in this package. It imports dolfinx and PETSc only when it
needs them, which keeps the help fast.
"""

from __future__ import annotations

import atexit
import errno
import gc
import io
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any

from fem_snh.errors import BadInput, Failed, choose
from fem_snh.processes import is_rank

if TYPE_CHECKING:
    from fem_snh.cli.options import Parser

#: Each command's module in this package, and its summary.
COMMANDS = {
    "run": ("run", "solve a scene: a built-in one, a TOML file or a Python function"),
    "sweep": ("run", "solve a scene for every combination of lists of values"),
    "fit": ("fit", "fit a material to test data, or rank all materials"),
    "materials": ("materials", "list the materials, describe one, or characterise them"),
    "plot": ("tools", "draw curves from run folders or a study's table"),
    "render": ("tools", "draw the deformed body of a run"),
    "view": ("tools", "write a run as one interactive HTML page"),
    "export": ("tools", "write a run as one VTKHDF file, or its surface as OBJ files"),
    "compile": ("compile", "compile the kernels of materials before runs need them"),
    "help": ("help", "tell what a key of a scene or a material is, and what it accepts"),
    "doctor": ("doctor", "check the installation"),
}
#: Errors of a full disk, which can also concern standard output.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
#: Characters of a word in a message, as a path, beyond which it is cut.
_LONGEST = 300
#: Seconds that a failing rank waits for the others to fail in the same way: their errors may be
#: late by a few seconds on a network file system.
_BARRIER_TIMEOUT = 10.0


def main(argv: list[str] | None = None) -> int:
    """Run the command line ``argv`` (default: the program's own) and return the exit code."""
    if argv is None:  # the process ends with this command
        # Python's last collections would visit all objects: a seventh of a small run's processor
        # time. Until `start_collector` none visits what is imported.
        atexit.register(gc.freeze)
        gc.disable()
        # pydantic reads the metadata of all installed packages for its plugins: 0.01 s.
        os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
        argv = sys.argv[1:]
    return exit_code(_dispatch, argv)


def start_collector() -> None:
    """Enable the garbage collector for new objects, if `main` has disabled it.

    Modules stay until the end. To visit their objects repeatedly takes 0.03 s of the 0.6 s of a
    small run.
    """
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def exit_code(command: Callable[[list[str]], int], argv: list[str]) -> int:
    """Run ``command(argv)``; turn every exception into an exit code and at most one line."""
    _open_standard_streams()
    # PETSc's handler reports every signal as a crash, SIGPIPE from `| head` included.
    if "-no_signal_handler" not in (options := os.environ.get("PETSC_OPTIONS", "")):
        os.environ["PETSC_OPTIONS"] = f"{options} -no_signal_handler"
    try:
        return command(argv)
    except BadInput as error:
        return _stop(str(error), 2)
    except Failed as error:
        return _stop(f"{error}; what was computed is kept", 1)
    except ImportError as error:
        if (error.name or "").startswith("fem_snh"):
            return _crash()
        return _stop(f"{error} ({sys.executable}): see `fem-snh doctor`", 2)
    except OSError as error:
        if isinstance(error, BrokenPipeError):  # `fem-snh materials | head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        if error.errno in _NO_ROOM:
            return _stop(f"cannot write: {error.strerror}", 2)
        return _stop(str(error), 2) if error.filename else _crash()
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # pressed again
        return _stop("interrupted; what was computed is kept", 130)
    except Exception:  # a bug: its traceback, and no rank waits for this one
        return _crash()


def start_petsc() -> None:
    """Start PETSc without the files .petscrc, unless PETSc is started already.

    A .petscrc in the working directory, which came with a scene, may name a library to load
    (``-dll_append``). PETSc reads the option to skip these files from its arguments only.
    """
    with suppress(ImportError):  # `fem_snh.cli.doctor.check` says what is missing
        import petsc4py

        petsc4py.init("-skip_petscrc")


def _open_standard_streams() -> None:
    """Open the null device for standard streams that are closed.

    Libraries expect the streams, and the next file that is opened would get a stream's number.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, closefd=False))
        # A name in letters that the terminal lacks is no reason to end a run.
        if mode == "w" and isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _dispatch(argv: list[str]) -> int:
    """Run the command that ``argv`` names, or print the usage or the version."""
    if not argv or argv[0] in ("-h", "--help"):
        print(usage())
        return 0
    if argv[0] == "--version":
        from importlib.metadata import version

        print(f"fem-snh {version('fem_snh')}")
        return 0
    name = choose("command", argv[0], COMMANDS)
    module = import_module(f"{__name__}.{COMMANDS[name][0]}")
    if name != "run":  # it has more to import
        start_collector()
    code: int = getattr(module, name)(argv[1:])
    sys.stdout.flush()
    return code


def parsers() -> dict[str, Parser]:
    """Return the argument parser of each command, from which the reference page is made."""
    by_command: dict[str, Parser] = {}
    for name, (module, _) in COMMANDS.items():
        by_command[name] = getattr(import_module(f"{__name__}.{module}"), f"{name}_parser")()
    return by_command


def usage() -> str:
    """Return the short help: the commands and two examples."""
    rows = [f"  {name:<11}{summary}" for name, (_, summary) in COMMANDS.items()]
    return "\n".join(
        [
            "fem-snh: Stable Neo-Hookean solids on gmsh meshes, by projected Newton, under MPI",
            "",
            *rows,
            "",
            "  fem-snh run twist --cells 8 --out out/twist",
            "  mpirun -n 2 fem-snh run stretch --material neo_hookean --out out/stretch",
            "",
            "`fem-snh COMMAND --help` lists the options of a command, `fem-snh help` the keys of a",
            "scene and the materials, `fem-snh help KEY` what a key is and accepts.",
        ]
    )


def _communicator() -> Any:
    """Return MPI's world communicator if there are other ranks, otherwise None."""
    if "mpi4py.MPI" not in sys.modules and not is_rank():
        return None  # MPI is not started
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError):
        return None
    return MPI.COMM_WORLD if MPI.COMM_WORLD.size > 1 and not MPI.Is_finalized() else None


def _stop(message: str, code: int) -> int:
    """Report on rank 0, wait for all ranks and return ``code``.

    MPI aborts the job if one rank exits first. A rank that waits longer than `_BARRIER_TIMEOUT` is
    the only one that failed; it aborts the job.
    """
    comm = _communicator()
    words = (w if len(w) <= _LONGEST else f"{w[:_LONGEST]}..." for w in message.split())
    line = "fem-snh: error: " + " ".join(words)
    if comm is None or comm.rank == 0:
        with suppress(OSError):  # standard error may be on the full disk
            print(line, file=sys.stderr, flush=True)
    if comm is not None:
        together, late = comm.Ibarrier(), time.monotonic() + _BARRIER_TIMEOUT
        while not together.Test():
            if time.monotonic() > late:
                if comm.rank != 0:
                    print(line, file=sys.stderr, flush=True)
                comm.Abort(code)
            time.sleep(0.01)
    return code


def _crash() -> int:
    """Print the traceback of a bug and abort the other ranks, which would wait for this one."""
    traceback.print_exc()
    comm = _communicator()
    if comm is not None:
        comm.Abort(1)
    return 1
