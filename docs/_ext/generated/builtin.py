"""Tables of the built-in scenes and materials."""

from __future__ import annotations

import csv
import io

import fem_snh
from fem_snh import scenes as built_in
from fem_snh.cli import help as reference
from fem_snh.materials import describe
from generated.table import table


def scenes() -> str:
    """Return a table of the built-in scenes with their own parameters and default values."""
    rows = []
    for name in built_in.names():
        own = (f"`{key}={_short(v)}`" for key, v in built_in.own_parameters(name).items())
        rows.append((f"`{name}`", built_in.describe(name), " ".join(own)))
    return table(("scene", "what it is", "its own parameters (`--set`)"), rows)


def materials() -> str:
    """Return a table of the built-in materials, and one of the keys of all."""
    rows = [(f"`{name}`", describe(name).partition("\n\n")[0]) for name in fem_snh.materials()]
    common = [(f"`{key}`", f"`{value}`", what) for key, value, what in reference.tuning()]
    tables = table(("material", "what it is"), rows), table(("key", "default", "meaning"), common)
    return "\n## Keys of every material\n\n".join(tables)


def material_keys() -> str:
    """Return the keys of each built-in material but the keys of all, as CSV."""
    common, text = reference.tuning(), io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("material", "key", "default", "meaning"))
    for name in fem_snh.materials():
        rows.writerows((name, *row) for row in reference.parameters(name) if row not in common)
    return text.getvalue()


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
