"""What the fields of tables accept, in words."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from pathlib import Path
from textwrap import fill, indent
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from fem_snh.tables.validation import Expect, Table

#: Columns of the text of `with_parameters`: those of the package's docstrings.
_WIDTH = 96


def with_parameters(table: type[Table]) -> str:
    """Return the docstring of a table with its fields as the section "Parameters"."""
    lines = [inspect.cleandoc(table.__doc__ or ""), "", "Parameters", "----------"]
    for name in table.positional_fields():
        field = table.model_fields[name]
        default = "" if field.is_required() else f", default {field.get_default()!r}"
        lines.append(f"{name} : {accepted(field)}{default}")
        lines.append(indent(fill(field.description or "", _WIDTH), "    "))
    return "\n".join(lines)


def accepted(field: FieldInfo) -> str:
    """Return what error messages say that a key accepts, else the kind of its values."""
    if found := _expected([*field.metadata, field.annotation]):
        return found
    kinds = ["a table"] if _is_table(field.annotation) else []
    kinds += ["a list of tables"] if is_list(field.annotation) else []
    return " or ".join(kinds) or _plain(field.annotation)


def _expected(parts: Iterable[Any]) -> str:
    """Return the text of the first `Expect` in a nested annotation."""
    for part in parts:
        if isinstance(part, Expect):
            return part.what
        if found := _expected([*get_args(part), *getattr(part, "__metadata__", ())]):
            return found
    return ""


def models(kind: Any) -> list[type[BaseModel]]:
    """Return the models that an annotation names."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [model for part in get_args(kind) for model in models(part)]


def is_list(kind: Any) -> bool:
    """Whether an annotation accepts a list of tables."""
    if getattr(kind, "__origin__", None) is list:
        return bool(models(kind))
    return any(is_list(part) for part in get_args(kind))


def _is_table(kind: Any) -> bool:
    """Whether an annotation accepts a table outside a list."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return True
    parts = () if getattr(kind, "__origin__", None) is list else get_args(kind)
    return any(_is_table(part) for part in parts)


def _plain(kind: Any) -> str:
    """Return the word for the first type of Python's in an annotation."""
    words = {bool: "true or false", int: "a whole number", str: "a text", Path: "a path"}
    return words.get(kind) or next((word for part in get_args(kind) if (word := _plain(part))), "")
