"""Tables of the built-in scenes and materials."""

from __future__ import annotations

import fem_snh
from fem_snh import scenes as built_in
from fem_snh.materials import defaults, describe
from generated.table import table


def scenes() -> str:
    """Return a table of the built-in scenes with their own parameters and default values."""
    rows = []
    for name in built_in.names():
        own = (f"`{key}={_short(v)}`" for key, v in built_in.own_parameters(name).items())
        rows.append((f"`{name}`", built_in.describe(name), " ".join(own)))
    return table(("scene", "what it is", "its own parameters (`--set`)"), rows)


def materials() -> str:
    """Return a table of the built-in materials with their shape parameters."""
    rows = []
    for name in fem_snh.materials():
        own = (f"`{key}={value}`" for key, value in defaults(name).items())
        first = describe(name).partition("\n\n")[0]
        rows.append((f"`{name}`", first, " ".join(own)))
    return table(("material", "source", "shape parameters"), rows)


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
