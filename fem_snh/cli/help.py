"""The command ``help``: what the keys of a scene and the materials are.

The texts come from the schema that validates scenes, from which the reference pages are made, too.
"""

from __future__ import annotations

import inspect
import json
import re
import shutil
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from fem_snh import cli
from fem_snh.cli.options import Parser
from fem_snh.errors import BadInput, suggestion_for, unknown_name
from fem_snh.materials import TUNING, defaults, describe, names, pins
from fem_snh.materials.parameters import MEANINGS
from fem_snh.materials.registry import published
from fem_snh.records.output_fields import NAMED
from fem_snh.scenes import MaterialChoice, Scene
from fem_snh.tables.validation import Table, accepted, suggestion, tables_in

EPILOG = """\
fem-snh help                      all keys of a scene and all materials
fem-snh help obstacle             a table of a scene and its keys
fem-snh help obstacle.friction    one key: what it is, what it accepts, its default
fem-snh help friction             the keys of this name in all tables
fem-snh help material.ogden       a material: its energy, source and parameters; also: ogden
"""
#: Largest width of the text, in columns.
_WIDTH = 100


def help_parser() -> Parser:
    """Return the parser of ``fem-snh help``."""
    return Parser(
        "help",
        "Tell what a key of a scene, a table or a material is, what it accepts, and its default.",
        """
        name KEY  a key with dots, as in --set, or a material; default: list all
        """,
        lambda: EPILOG,
        name={"nargs": "?"},
    )


def help(argv: list[str]) -> int:
    """Print what a key or a material is, or list all; return 0."""
    name = help_parser().parse(argv).name
    if name is None:
        _list()
    elif name in cli.COMMANDS:
        cli.parsers()[name].print_help()
    elif (material := name.removeprefix("scene.").removeprefix("material.")) in names():
        _material(material)
    else:
        for key in find(name):
            _key(key)
    return 0


def _list() -> None:
    """Print the top-level keys of a scene and the names of the materials."""
    print("Keys of a scene, of which `fem-snh help KEY` says more:\n")
    _columns((key.path, key.meaning) for key in keys_of(Scene))
    print("\nMaterials, of which `fem-snh help NAME` says more:\n")
    print(_filled(", ".join(names()), "  "))


def _material(name: str) -> None:
    """Print what a material is, and its keys beside E and nu."""
    print(f'[material]  name = "{name}"\n\n{describe(name)}\n\nKeys beside E and nu:\n')
    _columns(_parameters(parameters(name)))


def _parameters(rows: Iterable[tuple[str, str, str]]) -> list[tuple[str, str]]:
    """Return the names and texts for `_columns` of rows with name, default and meaning."""
    return [(name, f"{what.rstrip('.')}. Default: {default}.") for name, default, what in rows]


def _key(key: Key) -> None:
    """Print a key, and the keys of its tables."""
    print(_filled(key.path))
    print(_filled(_said(key), "  "))
    for table in key.tables:
        what = summary(table)
        print("" if what == key.meaning else "\n" + _filled(what) + "\n")
        _columns((inner.name, _said(inner)) for inner in keys_of(table))
        if table is MaterialChoice:
            _columns(_parameters(tuning()))
            print("\nMaterials, each with parameters of its own (`fem-snh help NAME`):\n")
            print(_filled(", ".join(names()), "  "))
    if key.path == "fields":
        print()
        _columns((name, field.meaning) for name, field in NAMED.items())
    print()


def _said(key: Key) -> str:
    """Return a text: what a key means, what it accepts, and its default."""
    meaning = key.meaning.rstrip(".")
    default = "" if key.default == "none" else f"; default: {key.default}"
    default = "; required" if key.default == "required" else default
    return f"{meaning}. Expected: {key.accepted}{default}."


def _columns(rows: Iterable[tuple[str, str]]) -> None:
    """Print names and texts in two columns."""
    rows = list(rows)
    width = max((len(name) for name, _ in rows), default=0) + 4
    for name, text in rows:
        print(_filled(text, f"  {name}".ljust(width), " " * width))


def _filled(text: str, first: str = "", further: str | None = None) -> str:
    """Return a text wrapped to the terminal's width; ``first`` and ``further`` begin its lines."""
    return textwrap.fill(
        " ".join(text.split()),
        min(shutil.get_terminal_size().columns, _WIDTH),
        initial_indent=first,
        subsequent_indent=first if further is None else further,
        break_long_words=False,
        break_on_hyphens=False,
    )


# --- what the schema says ------------------------------------------------------------------------


@dataclass(frozen=True)
class Key:
    """A key of a scene's table.

    Attributes
    ----------
    path : str
        The dotted path from the scene to the key: ``obstacle.shape.sphere``.
    accepted : str
        What the key accepts.
    default : str
        The default as in TOML; "required" if there is none, "none" if the key is left out.
    meaning : str
        The key's description.
    tables : tuple of type
        The classes of the tables that the key accepts.
    is_list : bool
        Whether the key accepts a list of tables.
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
        default = "required"
        if model is Scene and name == "name":
            default = "the file's name"  # the only key that a file gives by its own name
        elif not field.is_required():
            default = _toml(field.get_default(call_default_factory=True))
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
    """Yield the keys of all tables with their paths; a table within itself is left out."""
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
    """Return the keys with this dotted path, from the scene; if none, from any of its tables.

    Numbers in the path, as in ``move.0.translate``, and brackets are ignored.

    Raises
    ------
    BadInput
        For a path that no table has; the message suggests the nearest one.
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
    listed = [*Scene.model_fields, *names()]
    near = suggestion(path, listed) or suggestion_for(path, listed)
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


def _documented(material: str, parameter: str) -> str:
    """Return the description of a parameter in the docstring of a material."""
    for names_, text in re.findall(r"^(\w[\w, ]*) : .*\n((?: +.*\n?)+)", describe(material), re.M):
        if parameter in names_.split(", "):
            return " ".join(text.split())
    return "a parameter of its function"


def _toml(value: Any) -> str:
    """Return a value as TOML; "none" for None and empty values."""
    if value is None or value in ([], {}, ()):
        return "none"
    if isinstance(value, Table):
        return "{ " + ", ".join(f"{key} = {_toml(v)}" for key, v in value) + " }"
    return json.dumps(value, default=str)
