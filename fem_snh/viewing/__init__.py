"""Plots, pictures, pages and exports, made from the files of a run.

Functions that draw or export run in a process of their own (`fem_snh.processes`): without a
display OpenGL can abort its process, and h5py and VTK can conflict with the libraries of dolfinx.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from fem_snh import processes
from fem_snh.errors import BadInput

INSTALL = (
    "install libegl1 (apt install libegl1) or Xvfb (apt install xvfb), and VTK >= 9.4 from PyPI"
)
#: Seconds after which a process counts as hung, for example if the display does not answer.
_TIMEOUT = 900.0


def require(program: str, packages: Iterable[str], install: str = "") -> None:
    """Raise BadInput if a package that ``program`` needs is not installed."""
    for package in packages:
        if find_spec(package) is None:
            raise BadInput(f"{program} needs {package}: pip install {install or package}")


def ignore(*values: object) -> None:
    """Do nothing: the default of the callbacks that report progress."""


@contextmanager
def reading() -> Iterator[None]:
    """Provide a context or decorator that raises BadInput for Python's errors in a run's values."""
    try:
        yield
    except BadInput:
        raise
    except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError) as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise BadInput(f"the files of the run cannot be shown ({reason})") from None


@reading()
def run_elsewhere(
    function: str,
    *args: Any,
    report: Callable[..., None] | None = None,
    timeout: float = _TIMEOUT,
    opengl: bool = False,
) -> None:
    """Call a function in a new process; if it draws, with the first kind of OpenGL that works.

    Parameters
    ----------
    function, *args, report, timeout
        As for `fem_snh.processes.call`; the result is discarded.
    opengl : bool
        Whether the function draws.

    Raises
    ------
    BadInput
        If the function raises an exception, the process crashes or hangs, or no kind of OpenGL
        works.
    """
    message = ""
    for prefix, variables in _opengl_backends() if opengl else [([], {})]:
        try:
            processes.call(
                "VTK", function, *args,
                report=report, timeout=timeout, prefix=prefix, variables=variables,
            )  # fmt: skip
            return
        except (processes.Crashed, ImportError, OSError, RuntimeError) as error:
            message = str(error).removesuffix(processes.UNDAMAGED)[:200]
    raise BadInput(f"cannot draw without a display ({message}): {INSTALL}" if opengl else message)


def _opengl_backends() -> list[tuple[list[str], dict[str, str]]]:
    """Return command prefix and environment of each kind of OpenGL, the most likely one first.

    VTK >= 9.4 uses the window class that VTK_DEFAULT_OPENGL_WINDOW names; older builds have one
    class only.
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
