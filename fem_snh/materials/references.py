"""Materials outside the package: functions in files of the user's own, and entry points.

A reference ``gent.py:gent`` names a file and a function in it. Entry points of the group
``fem_snh.materials`` map a material's name to a function of an installed package.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput, nearest

#: The entry point group of packages that provide materials: name -> function.
GROUP = "fem_snh.materials"

#: Functions that were loaded: a file is imported again only after it has changed.
_loaded: dict[tuple[Path, int], Any] = {}


class Reference(str):
    """A reference ``FILE.py:FUNCTION`` whose file is relative to ``folder``.

    It compares and prints as the text that was given; a plain string of the same form is relative
    to the working directory.
    """

    folder: Path

    def __new__(cls, text: str, folder: Path | str = "") -> Reference:
        made = super().__new__(cls, text)
        made.folder = Path(folder)
        return made

    def __reduce__(self) -> tuple[Any, ...]:  # pickled from rank to rank
        return Reference, (str(self), self.folder)


def is_reference(name: str) -> bool:
    """Return True for a text ``FILE:FUNCTION`` (and for a file name, to explain the form)."""
    return ":" in name or name.endswith(".py")


def file_of(reference: str) -> Path:
    """Return the file of a reference."""
    folder = reference.folder if isinstance(reference, Reference) else Path()
    return folder / reference.rpartition(":")[0]


def load(reference: str) -> Callable[..., Any]:
    """Return the function that a reference names; its file is imported.

    Raises
    ------
    BadInput
        If the reference is malformed, the file does not exist or cannot be imported, or it does
        not define the function.
    """
    where = f"material = '{reference}'"
    path, name = file_of(reference), reference.rpartition(":")[2]
    if reference.endswith(".py") or not path.name or not name.isidentifier():
        example = f"{Path(reference.partition(':')[0]).stem or 'gent'}"
        raise BadInput(
            f"{where}: expected a file and a function in it, e.g. {example}.py:{example}"
        )
    try:
        path = path.resolve()
        module = _module(path, path.stat().st_mtime_ns)
    except OSError as error:
        raise BadInput(f"{where}: cannot read {path}: {error.strerror or error}") from None
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from None
    functions = [k for k, v in vars(module).items() if callable(v) and not k.startswith("_")]
    found = getattr(module, name, None)
    if not callable(found):
        raise BadInput(f"{where}: {path} has no function '{name}'{nearest(name, functions)}")
    function: Callable[..., Any] = found
    return function


def _module(path: Path, changed: int) -> Any:
    """Return the module of a Python file. Raises BadInput if its import fails."""
    if (path, changed) in _loaded:
        return _loaded[path, changed]
    unique = hashlib.sha256(f"{path} {changed}".encode()).hexdigest()[:12]
    name = f"fem_snh_material_{unique}_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise BadInput(f"cannot import {path}: expected a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    sys.path.insert(0, str(path.parent))  # for files beside it, as when Python runs a script
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise BadInput(
            f"cannot import {path}: {type(error).__name__}: {' '.join(str(error).split())}"
        ) from None
    finally:
        sys.path.remove(str(path.parent))
    _loaded[path, changed] = module
    return module


def entry_points() -> dict[str, metadata.EntryPoint]:
    """Return the entry points of the group ``fem_snh.materials`` by name."""
    return {point.name: point for point in metadata.entry_points(group=GROUP)}


def load_entry_point(point: metadata.EntryPoint) -> Callable[..., Any]:
    """Return the function of an entry point. Raises BadInput if it cannot be imported."""
    where = f"material '{point.name}' (entry point {point.value})"
    try:
        function = point.load()
    except Exception as error:
        raise BadInput(
            f"{where}: cannot be imported: {type(error).__name__}: {' '.join(str(error).split())}"
        ) from None
    if not callable(function):
        raise BadInput(f"{where}: expected a function, not {type(function).__name__}")
    found: Callable[..., Any] = function
    return found
