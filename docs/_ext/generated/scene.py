"""The tables of a scene file, from the schema that validates it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from fem_snh.cli import help as reference
from fem_snh.scenes import MaterialChoice, Scene
from fem_snh.tables.validation import Table
from generated.table import table


def markdown() -> str:
    """Return a section for each table of a scene file: what it is, and its keys."""
    parts = []
    for title, model in sections():
        keys = reference.keys_of(model)
        rows = [(f"`{k.name}`", k.accepted, _code(k.default), k.meaning) for k in keys]
        head = ("key", "accepts", "default", "meaning")
        parts += [f"## {title}", reference.summary(model), table(head, rows)]
    return "\n\n".join(parts)


def _code(default: str) -> str:
    return default if default in ("none", "required", "the file's name") else f"`{default}`"


def sections() -> Iterator[tuple[str, type[Table]]]:
    """Yield the tables of a scene once each, with headings that say where they are."""
    places: dict[type[Table], list[tuple[type[Table], reference.Key]]] = {Scene: []}
    ways: list[type[Table]] = [Scene]
    for model in ways:  # it grows
        for key in reference.keys_of(model):
            for inner in key.tables:
                ways += [] if inner in places else [inner]
                places.setdefault(inner, []).append((model, key))
    usual = {
        model: Counter(key.name for _, key in found).most_common(1)[0][0]
        for model, found in places.items()
        if found
    }
    for model, found in places.items():
        if model is Scene:
            yield "Top-level keys", model
            continue
        outer, key = found[0]
        required = next((k.name for k in reference.keys_of(model) if k.default == "required"), "")
        beside = f" with {required}" if len(key.tables) > 1 else ""
        if outer is Scene:
            single, many = f"[{key.name}]", f"[[{key.name}]]"
            kinds = (
                (single, many) if model is MaterialChoice else (many if key.is_list else single,)
            )
            yield ", ".join(kinds) + beside, model
        else:
            parents = dict.fromkeys(usual[parent] for parent, _ in found if parent is not model)
            yield f"{usual[model]}, of {', '.join(parents)}{beside}", model
