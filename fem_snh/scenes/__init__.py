"""Scenes: one experiment, one small file, one function that returns a `Scene`.

A scene is a module of ``builtin/`` with a function of the same name; its arguments (``cells`` and
whatever is its own) become options of the command line, its docstring's first line its description.
A scene may also be a TOML file with the same tables (`fem_snh.scenes.schema`). It knows meshes and
materials, never the solver.

    >>> from fem_snh import scenes
    >>> scenes.load("twist", nu=0.3, angle=1.57, **{"material.barrier": True}).material.nu
    0.3
"""

from __future__ import annotations

import inspect
import pkgutil
import tomllib
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import ValidationError, validate_call

from fem_snh.errors import BadInput, bad_value, nearest, note_rename, unknown_name
from fem_snh.materials import Reference
from fem_snh.scenes import builtin
from fem_snh.scenes._validation import one_line
from fem_snh.scenes.schema import (
    RENAMED,
    Geometry,
    Hold,
    MaterialChoice,
    Modes,
    Move,
    Probe,
    Rotate,
    Scene,
    Start,
    Traction,
)

__all__ = [
    "Geometry", "Hold", "MaterialChoice", "Modes", "Move", "Probe", "Rotate", "Scene",
    "Start", "Traction", "describe", "load", "names", "own_parameters",
]  # fmt: skip

_SHORT = {"material": "material.name", "E": "material.E", "nu": "material.nu"}


def names() -> list[str]:
    """The sorted names of the built-in scenes, found by scanning ``builtin/``."""
    found = (m.name for m in pkgutil.iter_modules(builtin.__path__))
    return sorted(name for name in found if name[0] != "_")


def function(name: str) -> Callable[..., Scene]:
    """The function that makes the scene ``name``. Raises BadInput for an unknown name."""
    if name not in names():
        raise bad_value("scene", name, f"one of {', '.join(names())}, or a .toml file", names())
    made: Callable[..., Scene] = getattr(import_module(f"{builtin.__name__}.{name}"), name)
    return made


def describe(name: str) -> str:
    """One line about the scene ``name``: the first of its function's docstring."""
    return (inspect.getdoc(function(name)) or "").partition("\n")[0]


def own_parameters(name: str) -> dict[str, Any]:
    """The arguments of the scene ``name`` with their defaults."""
    arguments = inspect.signature(function(name)).parameters
    return {key: argument.default for key, argument in arguments.items()}


def load(scene: str | Path | Scene, /, **overrides: Any) -> Scene:
    """The scene of this name, of this TOML file, or this one, with some of its values replaced.

    Args:
        scene: a name, a path that ends in ``.toml``, or a Scene.
        overrides: the scene function's own arguments; keys of `Scene`; ``material`` (a name, or a
            table), ``E`` and ``nu``; dotted keys such as ``material.barrier`` or
            ``move.0.translate``; ``petsc`` (a table) adds to the scene's. None is "as it was".
            Another material drops the shape parameters of the scene's.

    Raises:
        BadInput: one line that names the scene, the key, the value and what would be accepted.
    """
    given = {key: value for key, value in overrides.items() if value is not None or "." in key}
    given = {key: v.tolist() if hasattr(v, "tolist") else v for key, v in given.items()}
    for key in [key for key in given if key in RENAMED]:
        note_rename(key, RENAMED[key])
        given[RENAMED[key]] = given.pop(key)
    label, data, own, make = str(scene), {}, {}, None
    if isinstance(scene, Scene):
        label, data = scene.name, scene.model_dump()
    elif label.endswith(".toml"):
        data = read_toml(Path(scene))
    else:
        make, own = function(label), own_parameters(label)
    try:
        if make is not None:
            mine = {key: given.pop(key) for key in own if key in given}
            data = validate_call(config={"strict": True})(make)(**mine).model_dump()
        for key in given:
            known = dict.fromkeys([*own, *_SHORT, *Scene.model_fields, *RENAMED])
            if (first := key.partition(".")[0]) not in known:
                raise unknown_name("parameter", first, known)
        return Scene.model_validate(_replaced(data, given))
    except ValidationError as error:
        raise BadInput(f"{label}: {one_line(error)}") from None
    except BadInput as error:
        raise BadInput(f"{label}: {error}") from None


def read_toml(path: Path) -> dict[str, Any]:
    """A scene file's tables; its mesh becomes relative to the file, its name is the file's stem."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{path} is not valid TOML: {error}") from None
    except UnicodeDecodeError:
        raise BadInput(f"{path} is not valid TOML: it is not UTF-8 text") from None
    except OSError as error:
        others = {other.stem: other.name for other in path.parent.glob("*.toml")}
        near = nearest(path.stem, others).replace("'?)", ".toml'?)")
        raise BadInput(f"cannot read the scene {path}: {error.strerror}{near}") from None
    if isinstance(data.get("mesh"), str):
        data["mesh"] = path.parent / data["mesh"]
    material = data.get("material")
    for key in ("name", "lambda_part"):
        if isinstance(material, dict) and isinstance(material.get(key), str):
            material[key] = Reference(material[key], path.parent)
    if isinstance(material, str):
        data["material"] = Reference(material, path.parent)
    return {"name": path.stem} | data


def _replaced(data: dict[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """The tables ``data`` (changed in place) with the overrides put in."""
    choice = overrides.get("material", {})
    name = choice.get("name") if isinstance(choice, Mapping) else choice
    material = data.get("material")
    if name is not None and isinstance(material, dict) and material.get("name") != name:
        data["material"] = {key: material[key] for key in ("E", "nu") if key in material}
    for key, value in overrides.items():
        if isinstance(value, Mapping) and key in ("material", "petsc"):
            table = data.get(key)
            data[key] = (table if isinstance(table, dict) else {}) | dict(value)
        else:
            _put(data, _SHORT.get(key, key), value)
    return data


def _put(data: Any, key: str, value: Any) -> None:
    """data[a][b][c] = value for the dotted key a.b.c; missing tables on the way are made."""
    *way, last = key.split(".", 1) if key.startswith("petsc.") else key.split(".")
    try:
        for part in way:
            if isinstance(data, list):
                data = data[int(part)]
            else:
                if data.get(part) is None:
                    data[part] = {}
                data = data[part]
        data[int(last) if isinstance(data, list) else last] = value
    except (IndexError, ValueError, TypeError, AttributeError):
        raise BadInput(f"cannot set '{key}': the scene has nothing there") from None
