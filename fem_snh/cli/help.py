"""The command ``help``: what the keys of a scene and the materials are."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING

from fem_snh.cli.options import Parser
from fem_snh.errors import BadInput

if TYPE_CHECKING:
    from fem_snh.scenes.reference import Key

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
    parser = Parser(
        "help",
        "Tell what a key of a scene, a table or a material is, what it accepts, and its default.",
        lambda: EPILOG,
    )
    parser.add(
        """
        name KEY  a key with dots, as in --set, or a material; default: list all
        """,
        name={"nargs": "?"},
    )
    return parser


def help(argv: list[str]) -> int:
    """Print what a key or a material is, or list all; return 0."""
    name = help_parser().parse(argv).name

    from fem_snh import cli
    from fem_snh.materials import names

    if name is None:
        _list()
    elif name in cli.COMMANDS:
        cli.parsers()[name].print_help()
    elif (material := name.removeprefix("scene.").removeprefix("material.")) in names():
        _material(material)
    else:
        try:
            _keys(name)
        except BadInput:
            if not _parameter(material):  # asked last: it imports all materials
                raise
    return 0


def _list() -> None:
    """Print the top-level keys of a scene and the names of the materials."""
    from fem_snh.materials import names
    from fem_snh.scenes import reference
    from fem_snh.scenes.schema import Scene

    print("Keys of a scene, of which `fem-snh help KEY` says more:\n")
    _columns((key.path, key.meaning) for key in reference.keys_of(Scene))
    print("\nMaterials, of which `fem-snh help NAME` says more:\n")
    print(_filled(", ".join(names()), "  "))


def _material(name: str) -> None:
    """Print what a material is, and its keys beside E and nu."""
    from fem_snh.materials import describe
    from fem_snh.scenes import reference

    print(f'[material]  name = "{name}"\n\n{describe(name)}\n\nKeys beside E and nu:\n')
    _columns(_parameters(reference.parameters(name)))


def _parameter(name: str) -> bool:
    """Print what a parameter of materials is; return whether there is one of this name."""
    from fem_snh.scenes import reference

    found = [("every material", reference.tuning())] if name in reference.TUNING else []
    found += [(m, reference.parameters(m)) for m in reference.materials_with(name)]
    for material, rows in found:
        print(_filled(f"material.{name}, of {material}: {dict(_parameters(rows))[name]}"))
    return bool(found)


def _parameters(rows: Iterable[tuple[str, str, str]]) -> list[tuple[str, str]]:
    """Return names and texts of names, defaults and meanings."""
    return [(name, f"{what.rstrip('.')}. Default: {default}.") for name, default, what in rows]


def _keys(words: str) -> None:
    """Print the keys that a dotted path means, and the keys of their tables."""
    from fem_snh.materials import names
    from fem_snh.records.output_fields import NAMED
    from fem_snh.scenes import reference
    from fem_snh.scenes.schema import MaterialChoice

    alike: dict[tuple[object, ...], list[Key]] = {}
    for key in reference.find(words):
        same = (key.accepted, key.default, key.meaning, key.tables)
        alike.setdefault(same, []).append(key)
    for number, found in enumerate(alike.values()):
        key = found[0]
        print("\n" * bool(number) + _filled(", ".join(each.path for each in found)))
        print(_filled(_said(key), "  "))
        for table in key.tables:
            what = reference.summary(table)
            print("" if what == key.meaning else "\n" + _filled(what) + "\n")
            _columns((inner.name, _said(inner)) for inner in reference.keys_of(table))
            if table is MaterialChoice:
                _columns(_parameters(reference.tuning()))
                print("\nMaterials, each with parameters of its own (`fem-snh help NAME`):\n")
                print(_filled(", ".join(names()), "  "))
        if key.path == "fields":
            print()
            _columns((name, field.meaning) for name, field in NAMED.items())


def _said(key: Key) -> str:
    """Return what a key is, accepts and is by default."""
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
    """Return a text in lines that the terminal holds."""
    return textwrap.fill(
        " ".join(text.split()),
        min(shutil.get_terminal_size().columns, _WIDTH),
        initial_indent=first,
        subsequent_indent=first if further is None else further,
        break_long_words=False,
        break_on_hyphens=False,
    )
