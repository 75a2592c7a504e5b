"""Run a drawing program in a process of its own, with the first kind of OpenGL that works.

Without a display OpenGL can abort its process; the parent can then report it in one line. The
program reads its request as JSON from standard input and may print its progress. Exit code 2: the
last line on standard error says what is wrong with the request or its files. Any other code but 0:
the process could not draw, and the next kind of OpenGL is tried.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from tempfile import TemporaryFile
from threading import Timer
from typing import Any

from fem_snh.child_process import import_path, python
from fem_snh.errors import BadInput

INSTALL = (
    "install libegl1 (apt install libegl1) or Xvfb (apt install xvfb), and VTK >= 9.4 from PyPI"
)
#: Seconds after which a drawing process counts as hung, as with a display that does not answer.
_TIMEOUT = 900.0


def require(program: str, packages: Iterable[str], install: str = "") -> None:
    """Raise BadInput if a package that ``program`` needs is not installed."""
    for package in packages:
        if find_spec(package) is None:
            raise BadInput(f"{program} needs {package}: pip install {install or package}")


def draw_elsewhere(
    request: dict[str, Any],
    program: str = "fem_snh.viewing.render.drawing",
    report: Callable[[str], None] | None = None,
    timeout: float = _TIMEOUT,
) -> None:
    """Run a drawing program in a new process.

    Parameters
    ----------
    request : dict
        The program's input, as JSON can hold it.
    program : str
        The module that is run.
    report : callable, optional
        Called with each line that the program prints.
    timeout : float
        Seconds after which the process is ended.

    Raises
    ------
    BadInput
        If the program rejects its request, or no kind of OpenGL works.
    """
    message = ""
    for prefix, settings in _opengl_backends():
        command = [*prefix, *python(program)]
        env = {
            **os.environ,
            **import_path(),
            "PYVISTA_OFF_SCREEN": "true",
            "MPLBACKEND": "Agg",
            **settings,
        }
        code, said = _run(command, env, request, report, timeout)
        if code == 0:
            return
        if code == 2:
            raise BadInput(said)
        message = said[:200]
    raise BadInput(f"cannot draw without a display ({message}): {INSTALL}")


def run_elsewhere(
    request: dict[str, Any],
    program: str,
    report: Callable[[str], None] | None = None,
    timeout: float = _TIMEOUT,
) -> None:
    """Run a program that needs no OpenGL in a new process.

    Parameters and errors are those of `draw_elsewhere`.
    """
    command = python(program)
    code, said = _run(command, {**os.environ, **import_path()}, request, report, timeout)
    if code:
        raise BadInput(said)


def serve(function: Callable[[dict[str, Any]], object]) -> None:
    """Call ``function`` with the request on standard input: the main program of a worker.

    A BadInput ends the process with its message on standard error and exit code 2, as does an
    error of Python in the values of the request: no other kind of OpenGL would help.
    """
    request = json.load(sys.stdin)
    try:
        function(request)
    except BadInput as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError) as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        print(f"the files of the run cannot be shown ({reason})", file=sys.stderr)
        sys.exit(2)


def _run(
    command: list[str],
    env: dict[str, str],
    request: dict[str, Any],
    report: Callable[[str], None] | None,
    timeout: float,
) -> tuple[int, str]:
    """Run a command; return its exit code and the last line of its errors, or how it ended."""
    # A pipe to a process that dies early would raise SIGPIPE, so that files are used.
    with TemporaryFile("w+") as stdin, TemporaryFile("w+") as stderr:
        json.dump(request, stdin)
        stdin.seek(0)
        worker = subprocess.Popen(
            command, stdin=stdin, stdout=subprocess.PIPE, stderr=stderr, env=env, text=True
        )
        timer = Timer(timeout, worker.kill)
        timer.start()
        assert worker.stdout
        try:
            with worker.stdout:
                for line in worker.stdout:
                    if report:
                        report(line.rstrip("\n"))
            worker.wait()
            hung = not timer.is_alive()
        finally:  # also after a keyboard interrupt
            timer.cancel()
            worker.kill()
        stderr.seek(0)
        lines = stderr.read().strip().splitlines() or ["no word"]
    if hung:
        return -1, "the process hung"
    if worker.returncode < 0:
        return worker.returncode, f"killed by signal {-worker.returncode}"
    return worker.returncode, lines[-1]


def _opengl_backends() -> list[tuple[list[str], dict[str, str]]]:
    """Return command prefix and environment of each kind of OpenGL, the most likely one first.

    VTK >= 9.4 uses the window class that the variable names; older builds have one class only.
    """
    backends: list[tuple[list[str], dict[str, str]]] = [
        ([], {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}),
        ([], {"VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow"}),
    ]
    if os.environ.get("DISPLAY"):
        backends.append(([], {}))
    if shutil.which("xvfb-run"):
        backends.append((["xvfb-run", "-a"], {}))
    return backends
