"""Scene files, whole, or with a key or value that is missing, misspelt, huge or of another type."""

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
from benchmarks.fuzz.mutations import WHOLE
from fem_snh import scenes
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
#: The other unit of force of a run: exact in binary numbers.
_UNIT = 2.0**20
#: Keys that each run has.
_NEEDED = ("mesh", "cells", "element", "material", "hold", "petsc", "table")
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
    """Scene files, built-in and of the pages, with a number by 10 % larger: read and validated"""
    table = _copy(random.choice(_originals()))
    numbers = [(w, k) for w, k in _places(table) if type(w[k]) is float and w[k] not in (0, 1)]
    changed = ""
    if numbers and random.random() < WHOLE:
        where, key = random.choice(numbers)
        where[key] *= 1.1 if abs(where[key]) < 1e90 and key != "nu" else 0.9
        changed = repr(where[key])
    else:
        random.choice(_CHANGES)(random, table)
    (folder / "scene.toml").write_text(_text(table), encoding="utf-8", errors="replace")
    return ["scene.toml", changed]


def _validate(arguments: list[str]) -> int:
    """Read and validate a scene file, which keeps its numbers; a message says what is accepted."""
    path, changed = arguments
    try:
        scene = scenes.load(path)
    except BadInput as error:
        assert _HELPFUL.search(str(error)), str(error)
        raise
    found = scene.model_dump(mode="json")
    assert scenes.load(scene).model_dump(mode="json") == found
    if changed:
        assert float(changed) in [w[k] for w, k in _places(found) if type(w[k]) is float], changed
    return 0


def make_run(random: Random, folder: Path) -> list[str]:
    """Scenes of one cell of any loads, run in two units of force: displacements are the same"""
    table = _copy(_TINY)
    for key in random.sample([k for k in table if k not in _NEEDED], 4):
        del table[key]
    if "pressure" not in table:
        del table["table"]
    table["material"] |= {"E": 10 ** random.uniform(-3, 9), "nu": random.uniform(-0.3, 0.45)}
    table["element"] = random.choice(("Q1", "Q1P0", "Q2", "Q2Q1"))
    factor = table["material"]["E"] * random.uniform(0.1, 2)
    _scale_forces(table, factor)
    if random.random() >= WHOLE:
        random.choice(_MILD)(random, table)
        for key, most in (("cells", 2), ("steps", 4)):  # others would take hours
            if isinstance(value := table.get(key), int) and most < value <= 1_000_000:
                table[key] = most
        table["cells"] = table.get("cells", 1)
    (folder / "scene.toml").write_text(_text(table), encoding="utf-8", errors="replace")
    return ["scene.toml"]


def _scale_forces(table: dict[str, Any], factor: float) -> None:
    """Multiply all loads and stiffnesses but the material's."""
    for name, key in (("traction", "vector"), ("pressure", "value"), ("spring", "stiffness")):
        for entry in table.get(name, ()):
            value = entry[key]
            entry[key] = [factor * v for v in value] if isinstance(value, list) else factor * value
    if "gravity" in table:
        table["gravity"]["vector"] = [factor * v for v in table["gravity"]["vector"]]


def _run(arguments: list[str]) -> int:
    """Run the scene in two units of force: all forces and the energy are larger by the factor."""
    import fem_snh

    result = fem_snh.run(arguments[0], out="out", progress=False)
    if result.converged:
        table = tomllib.loads(Path(arguments[0]).read_text())
        table["material"]["E"] *= _UNIT
        _scale_forces(table, _UNIT)
        Path("other.toml").write_text(_text(table))
        other = fem_snh.run("other.toml", progress=False)
        assert other.converged
        x, y = (found.problem.x.array[: found.problem.u.x.array.size] for found in (result, other))
        assert abs(x - y).max() <= 1e-6 * abs(x).max()
        one, two = (found.steps[-1]["energy"] for found in (result, other))
        if one is not None:  # a pressure on a part of a surface has none
            limit = 1e-9 * table["material"]["E"]
            assert math.isclose(_UNIT * one, two, rel_tol=1e-6, abs_tol=limit), (one, two)
    return 0 if result.converged else 1


def _text(table: dict[str, Any]) -> str:
    """Return a table as the text of a scene file."""
    return "".join(f"{_quoted(k)} = {_toml(v)}\n" for k, v in table.items() if v is not None)


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
    return _copy(random.choice(random.choice((_NUMBERS, _NUMBERS, _TEXTS, _OTHERS))))


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
_MILD = (_scale, _scale, _scale, _scale, _group, _repeat, _drop)
_CHANGES: tuple[Callable[[Random, dict[str, Any]], None], ...] = (
    _replace, _replace, _replace, _drop, _rename, _repeat, _add, _group, _scale,
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
    "scene_run": Family(make_run, _run, ("fem_snh.runs",)),
}
