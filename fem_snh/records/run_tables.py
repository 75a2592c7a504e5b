"""The tables of a run, steps.csv and modes.csv, and the columns of its results.

A column of a vector has the name of the goal that is the same number: ``top.force.z``,
``inner.moment.z``, ``corner.y`` (`fem_snh.scenes.read_goal`).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fem_snh.records.run_record import is_number

_AXES = "xyz"
#: Tables of a row by the name of what they describe, and what their vectors are called.
_VECTORS = {"reactions": "force", "moments": "moment", "probes": ""}
#: Tables of a row by name that hold tables of their own: columns NAME.KEY.
_STATES = ("cavities", "rigid", "bones", "obstacles", "contacts")
#: Vectors of these tables that are the same in every step, or no result: they have no column.
_NO_COLUMN = ("pose", "deepest_at", "origin", "nodes")


def flat(step: Mapping[str, Any]) -> dict[str, Any]:
    """Return a step as a table row: a column for each component of what has several."""
    row: dict[str, Any] = {}
    for key, value in step.items():
        if key == "notes":
            row[key] = " ".join(value)
        elif not isinstance(value, dict | list):
            row[key] = value
    return row | results(step)


def results(step: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of a step that its scene asks for: reactions, probes, contacts, goals."""
    row: dict[str, Any] = {}
    for key in ("momentum", "angular_momentum"):
        row |= _components(key, step.get(key, ()))
    row |= {f"{name}.volume": ratio for name, ratio in step.get("volumes", {}).items()}
    for key, kind in _VECTORS.items():
        for name, vector in step.get(key, {}).items():
            row |= _components(f"{name}.{kind}".rstrip("."), vector)
    for key in _STATES:
        for name, state in step.get(key, {}).items():
            row |= dict(_columns(name, state))
    row |= dict(_columns("self_contact", step.get("self_contact", {})))
    row |= step.get("goals", {})
    row |= {f"{name}.error": error for name, error in step.get("errors", {}).items()}
    return row


#: Units of columns by their whole name or their last part, if the scene is in SI units.
_UNITS = {
    **dict.fromkeys(("residual", "tolerance", "force", "friction"), "N"),
    **dict.fromkeys(("energy", "kinetic", "elastic", "potential", "work", "dissipated"), "J"),
    **dict.fromkeys(("max_u", "mean", "position", "displacement", "penetration", "deepest"), "m"),
    **dict.fromkeys(("distance", "activation"), "m"),
    **dict.fromkeys(("time", "time_step"), "s"),
    "numerical_dissipation": "J",
    "moment": "N m",
    "rotation": "rad",
    **dict.fromkeys(("pressure", "E"), "Pa"),
    "stiffness": "Pa/m",
    "momentum": "kg m/s",
    "angular_momentum": "kg m^2/s",
}


def column_unit(name: str, step: Mapping[str, Any]) -> str:
    """Return the SI unit of a column of a step's `flat` row, or "".

    Of a quotient A/B of two columns it is that of the quotient.
    """
    row = flat(step)
    if name not in row and "/" in name:
        for at in (i for i, letter in enumerate(name) if letter == "/"):
            above, below = name[:at], name[at + 1 :]
            if above in row and below in row:
                return _quotient(column_unit(above, step), column_unit(below, step))
    body = name.removesuffix(".error")
    body = next((body.removesuffix(end) for end in (".x", ".y", ".z") if body.endswith(end)), body)
    if body in step.get("probes", {}):
        return "m"
    owner, _, kind = body.rpartition(".")
    if kind == "volume" and owner in step.get("cavities", {}):
        return "m^3"
    return _UNITS.get(kind, "")


def _quotient(above: str, below: str) -> str:
    """Return the unit of a quotient."""
    if above == below or not below:
        return "" if above == below else above
    return f"{above or '1'}/{below}" if below.isalpha() else f"{above or '1'}/({below})"


def _columns(name: str, state: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Return the columns of one obstacle, contact, bone or cavity."""
    for key, value in state.items():
        if key in _NO_COLUMN:
            continue
        if not isinstance(value, list | dict):
            yield f"{name}.{key}", value
        elif isinstance(value, list) and len(value) == len(_AXES) and is_number(value[0]):
            yield from _components(f"{name}.{key}", value).items()


def _components(name: str, vector: Sequence[float]) -> dict[str, float]:
    """Return a column for each component of a vector; none of an empty one."""
    return {f"{name}.{axis}": value for axis, value in zip(_AXES, vector, strict=False)}


def table_text(columns: Sequence[str], rows: list[dict[str, Any]]) -> str:
    """Return rows as CSV text."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
