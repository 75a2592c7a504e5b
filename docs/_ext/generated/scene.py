"""The tables of a scene file, from the schema that validates it."""

from __future__ import annotations

from fem_snh.scenes import reference
from generated.table import table


def markdown() -> str:
    """Return a section for each table of a scene file: what it is, and its keys."""
    parts = []
    for title, model in reference.sections():
        keys = reference.keys_of(model)
        rows = [(f"`{k.name}`", k.accepted, _code(k.default), k.meaning) for k in keys]
        head = ("key", "accepts", "default", "meaning")
        parts += [f"## {title}", reference.summary(model), table(head, rows)]
    return "\n\n".join(parts)


def _code(default: str) -> str:
    return default if default in ("none", "required", "the file's name") else f"`{default}`"
