"""Tables of the built-in scenes and materials."""

from __future__ import annotations

import fem_snh
from fem_snh import scenes as built_in
from fem_snh.materials import describe
from fem_snh.scenes import reference
from generated.table import table


def scenes() -> str:
    """Return a table of the built-in scenes with their own parameters and default values."""
    rows = []
    for name in built_in.names():
        own = (f"`{key}={_short(v)}`" for key, v in built_in.own_parameters(name).items())
        rows.append((f"`{name}`", built_in.describe(name), " ".join(own)))
    return table(("scene", "what it is", "its own parameters (`--set`)"), rows)


def materials() -> str:
    """Return a table of the built-in materials, and one of the keys of each and of all."""
    rows = [(f"`{name}`", describe(name).partition("\n\n")[0]) for name in fem_snh.materials()]
    common = reference.tuning()
    parts = [table(("material", "what it is"), rows), "## Keys of every material", _keys(common)]
    for name in fem_snh.materials():
        if own := [row for row in reference.parameters(name) if row not in common]:
            parts += [f"## Keys of {name}", _keys(own)]
    return "\n\n".join(parts)


def _keys(rows: list[tuple[str, str, str]]) -> str:
    head = ("key", "default", "meaning")
    return table(head, [(f"`{key}`", f"`{default}`", what) for key, default, what in rows])


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
