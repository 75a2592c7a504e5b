"""Load functions from outside the package: from a Python file of the user, or another package.

A reference is the text ``FILE.py:NAME``. An entry point is a function that an installed package
declares under ``fem_snh.materials`` or ``fem_snh.scenes``. The registries of materials and scenes
load both here. Every failure is a `BadInput`.
"""

from __future__ import annotations

import hashlib
import re
import sys
import traceback
from collections.abc import Callable
from functools import cache, partial
from importlib import metadata
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from fem_snh.errors import BadInput, nearest_file, suggestion_for

Function = Callable[..., Any]


class FileText(str):
    """A string from a scene file; a relative path in it starts from ``folder``.

    A path in a plain string is relative to the working directory.
    """

    folder: Path

    def __new__(cls, text: str, folder: Path) -> FileText:
        made = super().__new__(cls, text)
        made.folder = folder
        return made

    def __reduce__(self) -> tuple[Any, ...]:  # sent from rank to rank
        return FileText, (str(self), self.folder)


def folder_of(text: str) -> Path:
    """Return the folder of a `FileText`, the working directory for a plain string."""
    return text.folder if isinstance(text, FileText) else Path()


def is_reference(text: str) -> bool:
    """Return whether a text refers to a Python file: ``FILE.py:NAME``, or ``FILE.py`` alone."""
    return re.search(r"\.py(:|$)", text) is not None


def file_of(text: str) -> Path:
    """Return the path of a reference's file; any other text is itself the path."""
    return Path(text.rpartition(":")[0] if is_reference(text) and ":" in text else text)


def load_reference(reference: str) -> Function:
    """Return the function that ``FILE.py:NAME`` refers to.

    The file is executed once, and again only after it has changed. During execution its folder is
    the last entry of ``sys.path``, so that the file can import its neighbours.

    Parameters
    ----------
    reference : str
        ``FILE.py:NAME``, the path of a Python file and the name of a function in it; a relative
        path starts from `folder_of` the text.

    Returns
    -------
    callable
        The function.

    Raises
    ------
    BadInput
        If the reference has no name, the file does not exist or does not import, or it holds no
        function of that name.
    """
    file, _, name = reference.rpartition(":")
    if not file.endswith(".py") or not name.isidentifier():
        raise BadInput(f"'{reference}': expected FILE.py:NAME, a function in a Python file")
    path = folder_of(reference) / file
    try:
        state = path.stat()
    except OSError as error:
        raise BadInput(
            f"'{reference}': cannot read {path}: {error.strerror}{nearest_file(path)}"
        ) from None
    module = _execute(path.resolve(), state.st_mtime_ns, state.st_size)
    found = getattr(module, name, None)
    if found is None:
        functions = [key for key, v in vars(module).items() if callable(v) and key[0] != "_"]
        raise BadInput(
            f"'{reference}': {path} has no function '{name}'{suggestion_for(name, functions)}"
        )
    if not callable(found):
        raise BadInput(
            f"'{reference}': {name} is of type {type(found).__name__}: expected a function"
        )
    function: Function = found
    return function


@cache
def entry_points(group: str) -> dict[str, Callable[[], Function]]:
    """Return the entry points of a group: for each name, a call that loads its function.

    Parameters
    ----------
    group : str
        ``fem_snh.materials`` or ``fem_snh.scenes``.

    Returns
    -------
    dict
        For each name, in sorted order, a callable without arguments. It returns the function, or
        raises `BadInput` with the entry point's name and package if that cannot be loaded.
    """
    found = metadata.entry_points(group=group)
    return {
        point.name: partial(_load_entry_point, point)
        for point in sorted(found, key=lambda point: point.name)
    }


def _load_entry_point(point: metadata.EntryPoint) -> Function:
    """Return the function of an entry point; raise BadInput if loading fails."""
    package = f" of the package {point.dist.name}" if point.dist else ""
    label = f"entry point {point.group}: {point.name} = {point.value}{package}"
    try:
        found = point.load()
    except (Exception, SystemExit) as error:
        raise BadInput(f"{label}: {describe_error(error)}") from None
    if not callable(found):
        raise BadInput(f"{label}: it is of type {type(found).__name__}: expected a function")
    function: Function = found
    return function


@cache
def _execute(path: Path, _modified: int, _size: int) -> ModuleType:
    """Execute a Python file; return the module. Time and size of the file are cache keys."""
    # Two files of one name, in different folders, are two modules.
    name = f"_fem_snh_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
    spec = spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None  # the suffix is .py
    module = module_from_spec(spec)
    sys.modules[name] = module  # type hints and pickle look a function's module up there
    sys.path.append(str(path.parent))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise BadInput(f"{path} does not import: {describe_error(error, path)}") from None
    finally:
        sys.path.remove(str(path.parent))
    return module


def describe_error(error: BaseException, path: str | Path | None = None) -> str:
    """Return an error in one line, with the line number in the file ``path`` that raised it."""
    text = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
    line = error.lineno if isinstance(error, SyntaxError) else None
    if path is not None and line is None:
        frames = traceback.extract_tb(error.__traceback__)
        line = next((f.lineno for f in reversed(frames) if f.filename == str(path)), None)
    where = f"line {line}: " if line is not None else ""
    return f"{where}{type(error).__name__}{f': {text}' if text else ''}"
