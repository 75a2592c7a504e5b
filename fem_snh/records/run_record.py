"""What a run records: run.json, its notes, and the rows of steps.csv and modes.csv.

The column of a vector's component has the name of the goal with the same value: ``top.force.z``,
``inner.moment.z``, ``corner.y`` (`fem_snh.scenes.read_goal`).
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

from fem_snh.errors import BadInput
from fem_snh.files import read_text

#: The content of run.json, or of a part of it such as the row of a step.
Record = dict[str, Any]


def load_record(path: Path) -> Record:
    """Return the content of a run.json.

    Raises
    ------
    BadInput
        If the file cannot be read, or is not the record of a run.
    """
    try:
        record = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else ""
        reason = reason or str(error) or type(error).__name__
        raise BadInput(f"{path}: cannot be read: {reason.splitlines()[0]}") from None
    if not is_record(record):
        raise BadInput(f"{path}: not the record of a run: expected its scene, material and steps")
    return record


def is_record(content: object) -> TypeGuard[Record]:
    """Return whether JSON content has ``scene``, ``material`` and ``steps``, each with ``load``."""
    if not isinstance(content, dict) or not {"scene", "material", "steps"} <= content.keys():
        return False
    steps = content["steps"]
    return isinstance(steps, list) and all(
        isinstance(step, dict) and isinstance(step.get("load"), int | float) for step in steps
    )


_AXES = "xyz"
#: Keys of a step that have vectors by name, and what the columns call them: NAME.force.x.
_VECTORS = {"reactions": "force", "moments": "moment", "probes": ""}
#: Keys of a step that have tables by name: columns NAME.KEY.
_STATES = ("cavities", "rigid", "bones", "obstacles", "contacts")
#: Vectors of these tables that are the same in every step, or no result: they have no column.
_NO_COLUMN = ("pose", "deepest_at", "origin", "nodes")


def flat(step: Mapping[str, Any]) -> dict[str, Any]:
    """Return a step of run.json as a row of steps.csv, with a column for each component."""
    row: dict[str, Any] = {}
    for key, value in step.items():
        if key == "notes":
            row[key] = " ".join(value)
        elif not isinstance(value, dict | list):
            row[key] = value
    return row | results(step)


def results(step: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of a step's results: momenta, reactions, probes, contacts, goals, ..."""
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
    for kind in ("error", "bound"):
        row |= {f"{name}.{kind}": value for name, value in step.get(f"{kind}s", {}).items()}
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
    """Return a column's SI unit; "" if it has none or the step's `flat` row lacks the column."""
    if name not in flat(step):
        return ""
    body = name.removesuffix(".error").removesuffix(".bound")
    body = next((body.removesuffix(end) for end in (".x", ".y", ".z") if body.endswith(end)), body)
    if body in step.get("probes", {}):
        return "m"
    owner, _, kind = body.rpartition(".")
    if kind == "volume" and owner in step.get("cavities", {}):
        return "m^3"
    return _UNITS.get(kind, "")


def _columns(name: str, state: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the names and values of the columns of one obstacle, contact, bone or cavity."""
    for key, value in state.items():
        if key in _NO_COLUMN:
            continue
        if not isinstance(value, list | dict):
            yield f"{name}.{key}", value
        elif isinstance(value, list) and len(value) == len(_AXES) and isinstance(value[0], float):
            yield from _components(f"{name}.{key}", value).items()


def _components(name: str, vector: Sequence[float]) -> dict[str, float]:
    """Return a column for each component of a vector, which may be empty."""
    return {f"{name}.{axis}": value for axis, value in zip(_AXES, vector, strict=False)}


def table_text(columns: Sequence[str], rows: list[dict[str, Any]]) -> str:
    """Return rows as CSV text with a header; a cell is empty where a row lacks a column."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


#: Kinds of notes on how a state was reached. They also hold for a run that starts from the state.
NOTES_ON_PATH = ("jump", "start")


class Note(NamedTuple):
    """A note on a result.

    Attributes
    ----------
    kind : str
        ``supports`` (rigid motions that nothing constrains, or supports without an area),
        ``load``, ``folder`` (not locked), ``locking``, ``inverted``, ``jump`` (a state far away
        within one step), ``penetration`` (between the points at which contact acts), ``rounding``
        (forces known up to the rounding error), ``unstable``, ``start`` (nodes outside of the mesh
        of the run from which this one starts), ``pressure`` (known up to a constant), ``mesh``
        (cells that meet without being connected), ``energy`` (a motion gains energy), ``options``
        (PETSc options that no solver reads), ``stabilised`` (steps needed a proximal term) or
        ``targets`` (forces of self-contact depend on the targets that are kept).
    text : str
        One line: what is the matter, and what to do.
    step : int or None
        Number of the step in ``steps`` of run.json, from 0; None for the whole run or a program.
    values : mapping
        The numbers of the text, by name.
    """

    kind: str
    text: str
    step: int | None = None
    values: Mapping[str, Any] = {}

    def record(self) -> dict[str, Any]:
        """Return the note's entry in ``notes`` of run.json."""
        return {"kind": self.kind, "step": self.step, "text": self.text, **self.values}


def with_notes(status: str, number: int) -> str:
    """Return a status with the number of notes: "converged, 2 notes"."""
    return f"{status}, {number} note{'s' if number > 1 else ''}" if number else status
