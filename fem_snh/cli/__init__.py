"""The program ``fem-snh``: which command, and how every ending looks from outside.

Exit codes: 0 done and converged, 1 ran but did not converge, 2 bad input or environment (one line
on standard error, from rank 0, never a traceback), 130 interrupted. A command is a function
``name(argv) -> exit code`` of a module in this package; what is heavy is imported inside it.
"""

from __future__ import annotations

import errno
import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any

from fem_snh.errors import BadInput, Failed, RenamedKey, choose

COMMANDS = {
    "run": ("run", "solve a scene, or a scene file of your own"),
    "sweep": ("sweep", "solve a scene for every combination of comma lists of values"),
    "tradeoff": ("tradeoff", "measure what accuracy costs on a scene, and get advice"),
    "extremes": ("extremes", "run what must not break: scrambled, crushed, overloaded bodies"),
    "materials": ("materials", "list the materials, describe one, or measure what they are like"),
    "plot": ("tools", "curves from run folders or a study's table"),
    "render": ("tools", "a picture of the deformed body of a run folder"),
    "doctor": ("tools", "say whether this machine has what it takes"),
}
_format = warnings.formatwarning
# What MPI launchers set; without any of these there is one rank and no need to start MPI.
_LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK", "PMI_SIZE")
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # e.g. for what is printed
_PATIENCE = 10.0  # seconds for the other ranks to fail in the same way


def main(argv: list[str] | None = None) -> int:
    """Run the command line ``argv`` (default: the program's own) and return the exit code."""
    return exit_code(_dispatch, sys.argv[1:] if argv is None else argv)


def exit_code(command: Callable[[list[str]], int], argv: list[str]) -> int:
    """Run ``command(argv)``; turn every way it can end into an exit code and at most one line."""
    # PETSc takes every signal for a crash, `| head` closing the pipe included.
    os.environ["PETSC_OPTIONS"] = os.environ.get("PETSC_OPTIONS", "") + " -no_signal_handler"
    warnings.formatwarning = _format_warning
    try:
        return command(argv)
    except BadInput as error:
        return _stop(str(error), 2)
    except Failed as error:
        return _stop(f"{error}; what was computed is kept", 1)
    except ImportError as error:
        if (error.name or "").startswith("fem_snh"):
            return _crash()
        return _stop(f"{error} ({sys.executable}): see `fem-snh doctor` or run `make setup`", 2)
    except OSError as error:
        if isinstance(error, BrokenPipeError):  # `fem-snh materials | head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        if error.errno in _NO_ROOM:
            return _stop(f"cannot write: {error.strerror}", 2)
        return _stop(str(error), 2) if error.filename else _crash()
    except KeyboardInterrupt:
        return _stop("interrupted; what was computed is kept", 130)
    except Exception:
        return _crash()


def _format_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    line: str | None = None,
) -> str:
    """Return the note of a renamed key as one line, and other warnings as Python shows them."""
    if issubclass(category, RenamedKey):
        return f"fem-snh: note: {message}\n"
    return _format(message, category, filename, lineno, line)


def _dispatch(argv: list[str]) -> int:
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(usage())
        return 0
    if argv[0] == "--version":
        from importlib.metadata import version

        print(f"fem-snh {version('fem_snh')}")
        return 0
    name = choose("command", argv[0], COMMANDS)
    module = import_module(f"{__name__}.{COMMANDS[name][0]}")
    code: int = getattr(module, name)(argv[1:])
    sys.stdout.flush()
    return code


def usage() -> str:
    """The short help."""
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
            "`fem-snh COMMAND --help` says more.",
        ]
    )


def _communicator() -> Any:
    """MPI's world if there may be other ranks, otherwise None."""
    if "mpi4py.MPI" not in sys.modules and not any(name in os.environ for name in _LAUNCHED):
        return None
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError):
        return None
    return MPI.COMM_WORLD if MPI.COMM_WORLD.size > 1 and not MPI.Is_finalized() else None


def _stop(message: str, code: int) -> int:
    """Say it once, on rank 0, and leave together: a rank that leaves alone takes rank 0 with it.

    If the other ranks do not come (the mistake was on this rank only), end them all.
    """
    comm = _communicator()
    line = "fem-snh: error: " + " ".join(message.split())
    if comm is None or comm.rank == 0:
        with suppress(OSError):  # it may go to the disk that is full
            print(line, file=sys.stderr, flush=True)
    if comm is not None:
        together, late = comm.Ibarrier(), time.monotonic() + _PATIENCE
        while not together.Test():
            if time.monotonic() > late:
                if comm.rank != 0:
                    print(line, file=sys.stderr, flush=True)
                comm.Abort(code)
            time.sleep(0.01)
    return code


def _crash() -> int:
    """A bug: show the traceback, and take the other ranks along rather than let them wait."""
    traceback.print_exc()
    comm = _communicator()
    if comm is not None:
        comm.Abort(1)
    return 1
