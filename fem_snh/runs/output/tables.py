"""The tables of a run: steps.csv and modes.csv."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

#: Vectors in the rows of scenes in time.
_VECTORS = ("momentum", "angular_momentum")
#: Lists in the rows of obstacles and contacts, of which the force has columns.
_LISTS = ("force", "pose", "deepest_at")


def flat(step: dict[str, Any]) -> dict[str, Any]:
    """Return a step as a table row: a column for each component of what has several."""
    tables = ("reactions", "probes", "cavities", "obstacles", "contacts", "bones", "self_contact")
    nested = (*tables, "volumes", "errors", *_VECTORS)
    row = {key: value for key, value in step.items() if key not in nested}
    if "notes" in row:
        row["notes"] = " ".join(row["notes"])
    for key in _VECTORS:
        if key in step:
            row |= {f"{key}_{axis}": v for axis, v in zip("xyz", step[key], strict=True)}
    row |= {f"volume_ratio_{name}": ratio for name, ratio in step.get("volumes", {}).items()}
    errors = step.get("errors", {})
    row |= {f"error_{name.replace('.', '_')}": error for name, error in errors.items()}
    for kind in ("reaction", "probe"):
        for name, vector in step.get(f"{kind}s", {}).items():
            row |= {f"{kind}_{name}_{axis}": v for axis, v in zip("xyz", vector, strict=True)}
    for name, state in step.get("cavities", {}).items():
        row |= {f"cavity_{name}_{key}": value for key, value in state.items()}
    for name, state in step.get("bones", {}).items():
        for key in ("force", "moment"):
            pairs = zip("xyz", state[key], strict=True)
            row |= {f"{name}_{key}_{axis}": value for axis, value in pairs}
    contact = step.get("self_contact", {})
    scalars = {key: v for key, v in contact.items() if not isinstance(v, list)}
    row |= {f"self_contact_{key}": v for key, v in scalars.items()}
    touching = step.get("obstacles", {}) | step.get("contacts", {})
    for name, state in touching.items():
        row |= {f"{name}_force_{axis}": v for axis, v in zip("xyz", state["force"], strict=True)}
        row |= {f"{name}_{key}": v for key, v in state.items() if key not in _LISTS}
    return row


def table_text(columns: Sequence[str], rows: list[dict[str, Any]]) -> str:
    """Return rows as CSV text."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
