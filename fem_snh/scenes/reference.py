"""What a scene's keys and the materials are, in words, from the schema that validates them.

``fem-snh help`` and the reference pages are made from it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from fem_snh.errors import BadInput, nearest, unknown_name
from fem_snh.materials import TUNING, defaults, describe, names, names_in_literature, pins
from fem_snh.materials.parameters import MEANINGS
from fem_snh.materials.registry import published
from fem_snh.scenes.schema import Scene
from fem_snh.tables.validation import Table, accepted, suggestion, tables_in


@dataclass(frozen=True)
class Key:
    """A key of a scene's table.

    Attributes
    ----------
    path : str
        The keys from the scene to it, with dots: ``obstacle.shape.sphere``.
    accepted, default, meaning : str
        What it accepts, its default as in TOML ("required" without one), and what it is.
    tables : tuple of type
        The models of the tables that it accepts.
    is_list : bool
        Whether it accepts a list of them.
    """

    path: str
    accepted: str
    default: str
    meaning: str
    tables: tuple[type[Table], ...]
    is_list: bool

    @property
    def name(self) -> str:
        """The last key of the path."""
        return self.path.rpartition(".")[2]


def keys_of(model: type[Table], prefix: str = "") -> list[Key]:
    """Return the keys of a table, in the order of its class; ``prefix`` begins their paths."""
    model.model_rebuild()  # tables name each other before they exist
    found = []
    for name in model.positional_fields():
        field = model.model_fields[name]
        # The only key that a file gives by its own name.
        default = "the file's name" if model is Scene and name == "name" else _default(field)
        tables = tables_in(field.annotation)
        found.append(
            Key(
                prefix + name,
                accepted(field),
                default,
                field.description or "",
                tuple(dict.fromkeys(table for _, table in tables)),
                any(is_list for is_list, _ in tables),
            )
        )
    return found


def summary(model: type[Table]) -> str:
    """Return the first paragraph of a table's docstring, in one line."""
    return " ".join((inspect.getdoc(model) or "").partition("\n\n")[0].split())


def every_key() -> Iterator[Key]:
    """Yield the keys of all tables by their paths; those of a table in itself only once."""
    ways: list[tuple[str, type[Table], tuple[type[Table], ...]]] = [("", Scene, ())]
    while ways:
        prefix, model, outer = ways.pop(0)
        for key in keys_of(model, prefix):
            yield key
            ways += [
                (f"{key.path}.", table, (*outer, model))
                for table in key.tables
                if table not in (*outer, model)
            ]


def find(words: str) -> list[Key]:
    """Return the keys that a dotted path means, from the scene on or from any of its tables.

    Numbers in the path, as ``move.0.translate`` has, and brackets are left out.

    Raises
    ------
    BadInput
        For a path that no table has; the nearest is suggested.
    """
    parts = [p for p in re.split(r"[.\[\]\s]+", words.removeprefix("scene.")) if p]
    path = ".".join(part for part in parts if not part.isdigit())
    known = list(every_key())
    for found in (
        [key for key in known if key.path == path],
        [key for key in known if path and key.path.endswith(f".{path}")],
    ):
        if found:
            return found
    table, _, name = path.rpartition(".")
    inner = dict.fromkeys(k.name for k in known if table and k.path.rpartition(".")[0] == table)
    if inner:
        inner |= dict.fromkeys([*names(), *TUNING] if table == "material" else [])
        raise BadInput(f"{table}: {unknown_name('key', name, inner, suggestion(name, inner))}")
    listed = [*Scene.model_fields, *names(), *TUNING]
    near = suggestion(path, listed) or nearest(path, listed)
    raise BadInput(f"unknown key or material '{words}': expected what `fem-snh help` lists{near}")


def parameters(material: str) -> list[tuple[str, str, str]]:
    """Return a material's keys beside E and nu: name, default and meaning."""
    constants = [(key, "from E and nu", _documented(material, key)) for key in pins(material)]
    constants += [
        (key, "from E and nu", meaning)
        for each in published(material)
        for key, meaning in each.meanings.items()
    ]
    own = defaults(material).items()
    return [*constants, *((k, _toml(v), _documented(material, k)) for k, v in own), *tuning()]


def tuning() -> list[tuple[str, str, str]]:
    """Return the keys that every material has: name, default and meaning."""
    return [(key, _toml(default), MEANINGS[key]) for key, default in TUNING.items()]


def materials_with(parameter: str) -> list[str]:
    """Return the materials that have a shape parameter or a constant of this name."""
    return [
        name
        for name in names()
        if parameter in (*defaults(name), *pins(name), *names_in_literature(name))
    ]


def _documented(material: str, parameter: str) -> str:
    """Return what the docstring of a material says of a parameter."""
    for names_, text in re.findall(r"^(\w[\w, ]*) : .*\n((?: +.*\n?)+)", describe(material), re.M):
        if parameter in names_.split(", "):
            return " ".join(text.split())
    return "a parameter of its function"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    return _toml(field.get_default(call_default_factory=True))


def _toml(value: Any) -> str:
    """Return a value as a scene file has it; "none" for one that it leaves out."""
    if value is None or value in ([], {}, ()):
        return "none"
    if isinstance(value, BaseModel):
        return "{ " + ", ".join(f"{key} = {_toml(v)}" for key, v in value) + " }"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)
