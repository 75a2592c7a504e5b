"""Scene files with keys and values that are missing, misspelt, of other types, huge or nested."""

from __future__ import annotations

import datetime as dt
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import mutate
from fem_snh import cli, scenes
from fem_snh.errors import BadInput
from fem_snh.scenes import Scene

_DOCS = Path(__file__).parents[2] / "docs"
#: Values that take the place of another one.
_NUMBERS = (
    math.nan, math.inf, -math.inf, 0, -1, 0.0, -0.0, 1.5, 1e308, -1e300, 1e-308, 1e160, 2**31,
    2**63, -(2**63) - 1, 10**400, True, False,
)  # fmt: skip
_TEXTS = (
    "", " ", "x", "X" * 10_000, "\0", "a\nb", "\x1b[31m", "\u202eevil", "na\u00efve", "\U0001f600",
    "-x", "../../etc/passwd", "1e5", "true", "[1]", "*", "a.b.c", "%s%n", "{0}", "nowhere",
)  # fmt: skip
_OTHERS: tuple[Any, ...] = ([], {}, [[]], [{}], {"": 0}, [1, "a", {}], dt.date(1979, 5, 27), [None])
_FACTORS = (-1, 0, 2, 10, 1000, -1000, 10**6, 1e-3, 1e-6, 1e-12, 1e12, 1e60, 1e-60, 1e200, 1e-200)
#: Keys that no table has, and keys of other tables.
_KEYS = (
    "", "group", "groups", "value", "vector", "table", "E", "name", "mesh", "steps", "displacement",
    "a.b", "\u0130", "petsc", "K" * 5000, "translate", "__class__", "model_config", "scene", "self",
)  # fmt: skip
#: Words of a message that says what is wrong, or what is accepted.
_HELPFUL = re.compile("expected|not valid TOML|cannot read")
#: A body of one cell, which is run.
_TINY: dict[str, Any] = {
    "mesh": {"source": "cube", "parameters": {}},
    "cells": 1,
    "element": "Q1",
    "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3, "density": 1.0},
    "hold": [{"group": "bottom"}],
    "move": [{"group": "top", "translate": [0.0, 0.0, -0.1]}],
    "traction": [{"group": "left", "vector": [0.01, 0.0, 0.0]}],
    "pressure": [{"group": "right", "value": 0.01, "table": "ramp"}],
    "spring": [{"group": "front", "stiffness": 0.1}],
    "gravity": {"vector": [0.0, 0.0, -0.01]},
    "table": [{"name": "ramp", "points": [[0.0, 0.0], [1.0, 1.0]]}],
    "probe": [{"name": "tip", "point": [1.0, 1.0, 1.0]}],
    "reactions": ["bottom"],
    "fields": ["cauchy_stress"],
    "petsc": {"snes_max_it": 20},
}


def make_file(random: Random, folder: Path) -> list[str]:
    """Scene files, built-in and of the pages, with damaged keys and values: read and validated"""
    table = _copy(random.choice(_originals()))
    _write(random, folder, table)
    return ["scene.toml"]


def _validate(arguments: list[str]) -> int:
    """Read and validate a scene file; a message must say what is accepted."""
    try:
        scene = scenes.load(arguments[0])
    except BadInput as error:
        assert _HELPFUL.search(str(error)), str(error)
        raise
    assert scenes.load(scene).model_dump(mode="json") == scene.model_dump(mode="json")
    return 0


def make_run(random: Random, folder: Path) -> list[str]:
    """Scenes of one cell with damaged keys and values: run"""
    table = _copy(_TINY)
    for key in random.sample([k for k in table if k not in ("mesh", "material", "cells")], 6):
        if key != "element":
            del table[key]
    _write(random, folder, table, bounded=True)
    return ["run", "scene.toml", "--out", "out", "--quiet"]


def _write(random: Random, folder: Path, table: dict[str, Any], bounded: bool = False) -> None:
    """Write a damaged table as scene.toml; ``bounded``: its run stays a short one."""
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        random.choice(_MILD if bounded and random.random() < 0.8 else _CHANGES)(random, table)
    if bounded:  # valid numbers of cells and steps would take hours
        for key, most in (("cells", 2), ("steps", 4)):
            if isinstance(value := table.get(key), int) and most < value <= 1_000_000:
                table[key] = most
        table["cells"] = table.get("cells", 1)
    lines = [f"{_quoted(key)} = {_toml(v)}" for key, v in table.items() if v is not None]
    text = "\n".join([*lines, ""])
    data = text.encode("utf-8", "replace")
    if not bounded and random.random() < 0.05:
        data = mutate(random, data)
    (folder / "scene.toml").write_bytes(data)


@cache
def _originals() -> list[dict[str, Any]]:
    """Return the tables of the built-in scenes and of the scene files in the pages."""
    found = [scenes.load(name).model_dump(mode="json") for name in scenes.names()]
    body = {key: _TINY[key] for key in ("mesh", "cells", "element", "material")}
    for page in sorted(_DOCS.rglob("*.md")):
        for block in re.findall(r"^```toml\n(.*?)^```", page.read_text(), re.M | re.S):
            table = tomllib.loads(block)
            if set(table) <= set(Scene.model_fields):  # many are parts of a scene
                found.append(table if "mesh" in table else body | table)
    return found


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Return all (table or list, key or index) of nested tables and lists."""
    entries = value.items() if isinstance(value, dict) else enumerate(value)
    for key, entry in list(entries):
        yield value, key
        if isinstance(entry, dict | list):
            yield from _places(entry)


def _place(random: Random, table: dict[str, Any]) -> tuple[Any, Any]:
    """Return a random place of a table; of an empty one, a new key."""
    return random.choice([*_places(table)] or [(table, "x")])


def _hostile(random: Random) -> Any:
    kind = random.choice((_NUMBERS, _NUMBERS, _TEXTS, _OTHERS))
    if random.random() < 0.03:
        nested: Any = 1
        for _ in range(60):
            nested = [nested] if random.random() < 0.5 else {"a": nested}
        return nested
    return _copy(random.choice(kind))


def _replace(random: Random, table: dict[str, Any]) -> None:
    """Replace a value."""
    where, key = _place(random, table)
    where[key] = _hostile(random)


def _drop(random: Random, table: dict[str, Any]) -> None:
    """Leave a value out."""
    where, key = _place(random, table)
    if key in where if isinstance(where, dict) else True:
        del where[key]


def _rename(random: Random, table: dict[str, Any]) -> None:
    """Misspell a key, or replace it by another one."""
    tables = [(w, k) for w, k in _places(table) if isinstance(w, dict)]
    if tables:
        where, key = random.choice(tables)
        at = random.randrange(len(key) + 1)
        misspelt = (key[:at] + key[at + 1 :], key[:at] + "x" + key[at:], key.upper())
        where[random.choice((*misspelt, random.choice(_KEYS)))] = where.pop(key)


def _repeat(random: Random, table: dict[str, Any]) -> None:
    """Repeat an entry of a list."""
    lists = [(w, k) for w, k in _places(table) if isinstance(w, list)]
    if lists:
        where, index = random.choice(lists)
        where += [_copy(where[index])] * random.choice((1, 1, 2, 50))


def _add(random: Random, table: dict[str, Any]) -> None:
    """Add a key that the table does not have."""
    tables = [table, *(w[k] for w, k in _places(table) if isinstance(w[k], dict))]
    random.choice(tables)[random.choice(_KEYS)] = _hostile(random)


def _swap(random: Random, table: dict[str, Any]) -> None:
    """Exchange two values."""
    (a, i), (b, k) = _place(random, table), _place(random, table)
    if i in a and k in b if isinstance(a, dict) and isinstance(b, dict) else False:
        a[i], b[k] = _copy(b[k]), _copy(a[i])


def _group(random: Random, table: dict[str, Any]) -> None:
    """Name a group that the mesh does not have, or another one."""
    groups = [(w, k) for w, k in _places(table) if k == "group"]
    if groups:
        where, key = random.choice(groups)
        where[key] = random.choice(
            ("nowhere", "botom", 1, 99, 2**31 - 1, "surface:top", "volume:x")
        )


def _scale(random: Random, table: dict[str, Any]) -> None:
    """Multiply a number, so that its type stays a valid one."""
    numbers = [(w, k) for w, k in _places(table) if type(w[k]) in (int, float)]
    if numbers:
        where, key = random.choice(numbers)
        where[key] = type(where[key])(where[key] * random.choice(_FACTORS))


#: Changes that leave most scenes valid.
_MILD = (_scale, _scale, _scale, _scale, _group, _repeat, _swap, _drop)
_CHANGES: tuple[Callable[[Random, dict[str, Any]], None], ...] = (
    _replace, _replace, _replace, _drop, _rename, _repeat, _add, _swap, _group, _scale,
)  # fmt: skip


def _copy(value: Any) -> Any:
    """Return tables and lists of which none is another's; numbers and texts as they are."""
    if isinstance(value, dict):
        return {key: _copy(entry) for key, entry in value.items()}
    return [_copy(entry) for entry in value] if isinstance(value, list | tuple) else value


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _toml(value: Any) -> str:
    """Return a value in TOML; tables are inline ones, and None, which TOML has not, is empty."""
    if isinstance(value, dict):
        pairs = (f"{_quoted(k)} = {_toml(v)}" for k, v in value.items() if v is not None)
        return "{ " + ", ".join(pairs) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return '""'
    return str(value)


FAMILIES = {
    "scene": Family(make_file, _validate, ("fem_snh.scenes", "fem_snh.materials.making")),
    "scene_run": Family(make_run, cli.main),
}
