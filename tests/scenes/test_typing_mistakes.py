"""Typing mistakes in any key of any table, from the schema: one line that begins with the key."""

from __future__ import annotations

import datetime as dt
import re
from math import inf, nan
from typing import Any

import pytest
from pydantic import create_model
from pydantic.fields import FieldInfo

from fem_snh.cli import help as reference
from fem_snh.errors import BadInput
from fem_snh.scenes import MaterialChoice, Scene
from fem_snh.tables.validation import Expect, OneOf, Table, Whole, accepted

pytestmark = pytest.mark.one_debian

TABLES = list(dict.fromkeys([Scene, *(t for key in reference.every_key() for t in key.tables)]))
FIELDS = [(table, name) for table in TABLES for name in table.model_fields]
FIELDS.remove((MaterialChoice, "name"))  # a function, too: its table validates it
#: What TOML may have, but no key of a scene accepts.
WRONG = dt.date(2024, 2, 29)
#: Values that are refused, by what a key expects.
OUTSIDE: dict[str, tuple[Any, ...]] = {
    "a finite number": (inf, nan, True, "1"),
    "a number > 0": (0, -1.0, inf, nan, "1 m"),
    "a number >= 0": (-1e-9, inf, nan),
    "three finite numbers, [x, y, z]": ([0, 1], [0, 1, inf], [0, 1, 2, 3], 1.0),
    "two finite numbers": ([0], [0, nan], 1.0),
    "true or false": (0, 1, "true"),
    "a list of 'x', 'y', 'z'": (["u"], [], ["x"] * 4),
}
KEYS = pytest.mark.parametrize(
    ("table", "name"), FIELDS, ids=lambda part: getattr(part, "__name__", part)
)


def mistake(table: type[Table], name: str, value: Any) -> str | None:
    """Return the message for a value of a key in a table of its own; None if it is accepted."""
    field = table.model_fields[name]
    alone: Any = create_model("Alone", __base__=Table, **{name: (field.annotation, field)})
    try:
        alone(**{name: value})
    except BadInput as error:
        return str(error)
    return None


def annotations(field: FieldInfo, kind: type[Expect]) -> list[Any]:
    """Return the annotations of a kind that a key has itself or, if it is optional, its type."""
    return [
        found
        for part in (field, *getattr(field.annotation, "__args__", ()))
        for found in (*getattr(part, "metadata", ()), *getattr(part, "__metadata__", ()))
        if isinstance(found, kind)
    ]


@KEYS
def test_wrong_type(table: type[Table], name: str) -> None:
    message = mistake(table, name, WRONG)
    assert message and "\n" not in message
    assert re.match(rf"{name}[.\w]* = datetime.date\(2024, 2, 29\): expected ", message), message
    if annotations(table.model_fields[name], Expect):
        assert f"expected {accepted(table.model_fields[name])}" in message


@KEYS
def test_odd_values(table: type[Table], name: str) -> None:
    """They are accepted, or refused in one line that begins with the key."""
    for value in ("", [], {}, [WRONG], {"no_such_key": 1}, [{"no_such_key": 1}], float("nan")):
        if message := mistake(table, name, value):
            assert re.match(rf"{name}\b.*expected ", message), message
            assert "\n" not in message


@KEYS
def test_bounds_and_words(table: type[Table], name: str) -> None:
    field = table.model_fields[name]
    for whole in annotations(field, Whole):
        for value in (whole.lowest - 1, whole.highest + 1, float(whole.lowest), True, "1"):
            assert mistake(table, name, value) == f"{name} = {value!r}: expected {whole.what}"
        assert mistake(table, name, whole.lowest) is None
        assert mistake(table, name, whole.highest) is None
    for expected in annotations(field, Expect):
        for value in OUTSIDE.get(expected.what, ()):
            assert mistake(table, name, value) == f"{name} = {value!r}: expected {expected.what}"
    for words in annotations(field, OneOf):
        for word in words.words:
            assert mistake(table, name, word) is None
            message = mistake(table, name, f"{word}_")
            assert message and message.startswith(f"{name} = '{word}_': expected {words.what} (did")


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_unknown_and_missing_keys(table: type[Table]) -> None:
    first, *_ = names = table.positional_fields()
    if table is not MaterialChoice:  # the material's own parameters are further keys
        with pytest.raises(BadInput, match=f"^unknown key '{first}x': expected one of {first}"):
            table(**{f"{first}x": 1})
    required = [name for name in names if table.model_fields[name].is_required()]
    if required:
        with pytest.raises(BadInput, match=f"^missing key '({'|'.join(required)})': expected "):
            table()


def test_tables_within_tables() -> None:
    """The key of a mistake has the keys of all tables on the way to it."""
    for key in reference.every_key():
        if key.tables and not key.is_list and "." not in key.path and key.path != "material":
            message = mistake(Scene, key.path, {"no_such_key": 1})
            assert message and message.startswith(f"{key.path}: unknown key 'no_such_key'"), message
