"""Call a function in a process of its own, with the first kind of OpenGL that works.

Without a display OpenGL can abort its process; the parent can then report it in one line. Libraries
that do not get along with those of dolfinx have a process of their own, too. The function may print
its progress. Exit code 2: the last line on standard error says what is wrong with the arguments or
their files. Any other code but 0: the process could not draw, and the next kind of OpenGL is tried.
"""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from importlib import import_module
from importlib.util import find_spec
from tempfile import TemporaryFile
from threading import Timer
from typing import Any

from fem_snh.errors import BadInput
from fem_snh.processes import import_path, python

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


def run_elsewhere(
    module: str,
    function: str,
    *args: Any,
    report: Callable[[str], None] | None = None,
    timeout: float = _TIMEOUT,
    opengl: bool = False,
) -> None:
    """Call a function of a module in a new process, which imports it.

    Parameters
    ----------
    module, function : str
        Their names.
    *args : Any
        Its arguments, which can be pickled.
    report : callable, optional
        Called with each line that the function prints.
    timeout : float
        Seconds after which the process is ended.
    opengl : bool
        Whether the function draws.

    Raises
    ------
    BadInput
        If the function does, or no kind of OpenGL works.
    """
    request, message = pickle.dumps((module, function, args)), ""
    for prefix, settings in _opengl_backends() if opengl else [([], {})]:
        env = {**os.environ, **import_path(), **settings}
        code, said = _run([*prefix, *python(__name__)], env, request, report, timeout)
        if code == 0:
            return
        if code == 2 or not opengl:
            raise BadInput(said)
        message = said[:200]
    raise BadInput(f"cannot draw without a display ({message}): {INSTALL}")


def _serve() -> None:
    """Call the function that standard input names.

    A BadInput ends the process with its message on standard error and exit code 2, as does an
    error of Python in the values of the arguments: no other kind of OpenGL would help.
    """
    try:
        module, function, args = pickle.load(sys.stdin.buffer)
        getattr(import_module(module), function)(*args)
    except BadInput as error:
        sys.stderr.write(f"{error}\n")
    except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError) as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        sys.stderr.write(f"the files of the run cannot be shown ({reason})\n")
    else:
        return
    sys.exit(2)


def _run(
    command: list[str],
    env: dict[str, str],
    request: bytes,
    report: Callable[[str], None] | None,
    timeout: float,
) -> tuple[int, str]:
    """Run a command; return its exit code and the last line of its errors, or how it ended."""
    # A pipe to a process that dies early would raise SIGPIPE, so that files are used.
    with TemporaryFile() as stdin, TemporaryFile("w+") as stderr:
        stdin.write(request)
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
    drawing = {"PYVISTA_OFF_SCREEN": "true", "MPLBACKEND": "Agg"}
    backends: list[tuple[list[str], dict[str, str]]] = [
        ([], drawing | {"VTK_DEFAULT_OPENGL_WINDOW": window})
        for window in ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
    ]
    if os.environ.get("DISPLAY"):
        backends.append(([], drawing))
    if shutil.which("xvfb-run"):
        backends.append((["xvfb-run", "-a"], drawing))
    return backends


if __name__ == "__main__":
    _serve()
