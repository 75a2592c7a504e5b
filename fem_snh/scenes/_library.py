"""Find scene functions: built-in ones, those of other packages, and those in Python files.

`fem_snh.scenes._loading` and the command line call it.
"""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import ValidationError, validate_call

from fem_snh.errors import BadInput, bad_value, nearest_file
from fem_snh.references import describe_error, entry_points, is_reference, load_reference
from fem_snh.scenes import builtin
from fem_snh.scenes.schema import Scene

SceneFunction = Callable[..., Any]

#: Entry point group under which a package declares functions that return a `Scene`.
GROUP = "fem_snh.scenes"


def names() -> list[str]:
    """Return the sorted names of the scenes: built-in ones and entry points."""
    return sorted({*_builtin_names(), *entry_points(GROUP)})


def function(name: str) -> SceneFunction:
    """Return the function that makes a scene.

    Parameters
    ----------
    name : str
        One of `names`, or ``FILE.py:NAME``.

    Raises
    ------
    BadInput
        If the name is unknown, or its file or package does not import.
    """
    if is_reference(name):
        return load_reference(name)
    if name in _builtin_names():  # a package cannot replace them
        made: SceneFunction = getattr(import_module(f"{builtin.__name__}.{name}"), name)
        return made
    if name in (found := entry_points(GROUP)):
        return found[name]()
    accepted = f"one of {', '.join(names())}, a .toml file or FILE.py:NAME"
    if file := nearest_file(Path(f"{name}.toml")):
        raise bad_value("scene", name, accepted + file)
    raise bad_value("scene", name, accepted, names())


def describe(name: str) -> str:
    """Return the first line of the docstring of the function that makes a scene."""
    return (inspect.getdoc(function(name)) or "").partition("\n")[0]


def own_parameters(name: str) -> dict[str, Any]:
    """Return the parameters of the function that makes a scene, with their defaults."""
    return parameters(function(name))


def parameters(function: SceneFunction) -> dict[str, Any]:
    """Return the named parameters of a scene function with their defaults, or None."""
    return {
        key: None if parameter.default is parameter.empty else parameter.default
        for key, parameter in inspect.signature(function).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }


def make_scene(function: SceneFunction, arguments: dict[str, Any]) -> Scene:
    """Call a scene function with validated arguments and check its result.

    Raises
    ------
    ValidationError
        For an argument, or a value that the function gives a table, which is not accepted.
    BadInput
        If the function fails in another way, or returns no `Scene`.
    """
    try:
        scene = validate_call(config={"strict": True})(function)(**arguments)
    except (ValidationError, BadInput):
        raise
    except Exception as error:
        raise BadInput(describe_error(error, inspect.getsourcefile(function))) from None
    if not isinstance(scene, Scene):
        raise BadInput(f"returned {type(scene).__name__}: expected a fem_snh.scenes.Scene")
    return scene


def _builtin_names() -> set[str]:
    found = (module.name for module in pkgutil.iter_modules(builtin.__path__))
    return {name for name in found if name[0] != "_"}
