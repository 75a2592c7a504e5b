"""The table of the fields that a scene may name."""

from __future__ import annotations

from fem_snh.records.output_fields import NAMED
from generated.table import table


def markdown() -> str:
    """Return a table of `NAMED`: name, components, unit and meaning."""
    rows = [
        (f"`{name}`", ", ".join(field.components), field.unit, field.meaning)
        for name, field in NAMED.items()
    ]
    return table(("field", "components", "unit", "meaning"), rows)
