"""What a run records: run.json, its notes, and the rows of steps.csv and modes.csv.

The content of run.json, which may be damaged or of other origin, is checked before it is used. A
column of a vector has the name of the goal that is the same number: ``top.force.z``,
``inner.moment.z``, ``corner.y`` (`fem_snh.scenes.read_goal`).
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from fem_snh.errors import BadInput, shown
from fem_snh.files import read_text

#: The content of a run.json.
Record = dict[str, Any]
#: Returns what is wrong with the value of a key, as text, or "".
Check = Callable[[str, object], str]


def load_record(path: Path) -> Record:
    """Return the content of a run.json.

    Raises
    ------
    BadInput
        If it cannot be read, or is not the record of a run.
    """
    try:
        record = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else ""
        reason = reason or str(error) or type(error).__name__
        raise BadInput(f"{path}: cannot be read: {reason.splitlines()[0]}") from None
    if reason := problem(record):
        raise BadInput(f"{path}: not the record of a run: {reason}")
    return dict(record)


def problem(record: object) -> str:
    """Return what is wrong with a record as ``key = value: expected ...``, or ""."""
    return _RECORD("", record)


def _expected(key: str, value: object, accepted: str) -> str:
    return f"{key.removeprefix('.') or 'content'} = {shown(value)}: expected {accepted}"


def is_number(value: object) -> bool:
    """Return whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _check(test: Callable[[Any], bool], accepted: str) -> Check:
    return lambda key, value: "" if test(value) else _expected(key, value, accepted)


_number = _check(is_number, "a number")
# A step that failed may have an infinite residual or energy, which only run.json has as null.
_number_or_null = _check(
    lambda v: v is None or (isinstance(v, int | float) and not isinstance(v, bool)),
    "a number or null",
)
_positive = _check(lambda v: is_number(v) and v > 0, "a number > 0")
_whole = _check(lambda v: isinstance(v, int) and not isinstance(v, bool), "a whole number")
_flag = _check(lambda v: isinstance(v, bool), "true or false")
_text = _check(lambda v: isinstance(v, str), "a text")


def _list(item: Check, length: int | None = None) -> Check:
    """Return the check of a list, of this length if it is given."""

    def check(key: str, value: object) -> str:
        if not isinstance(value, list) or (length is not None and len(value) != length):
            return _expected(key, value, "a list" if length is None else f"a list of {length}")
        return next((found for i, v in enumerate(value) if (found := item(f"{key}[{i}]", v))), "")

    return check


def _named(item: Check) -> Check:
    """Return the check of a table with any keys."""

    def check(key: str, value: object) -> str:
        if not isinstance(value, dict):
            return _expected(key, value, "a table")
        return next((found for k, v in value.items() if (found := item(f"{key}.{k}", v))), "")

    return check


def _table(required: Mapping[str, Check], optional: Mapping[str, Check]) -> Check:
    """Return the check of a table with these keys, and any others."""

    def check(key: str, value: object) -> str:
        if not isinstance(value, dict):
            return _expected(key, value, "a table")
        if missing := [name for name in required if name not in value]:
            return f"{key}.{missing[0]}: missing".removeprefix(".")
        checks = {**required, **optional}
        return next(
            (
                found
                for k, v in value.items()
                if k in checks and (found := checks[k](f"{key}.{k}", v))
            ),
            "",
        )

    return check


def _any(key: str, value: object) -> str:
    return ""


def _material(key: str, value: object) -> str:
    """Check one material, or a list of several."""
    one = _table({"name": _text, "nu": _number}, {"E": _number, "parameters": _named(_any)})
    return _list(one)(key, value) if isinstance(value, list) and value else one(key, value)


_POSE = _list(_list(_number, 4), 3)
_MOVED = _named(_table({}, {"pose": _POSE}))
_VALUES = (
    "time", "newton", "clamped", "linear", "lbfgs", "residual", "energy", "kinetic", "elastic",
    "potential", "dissipated", "volume_ratio", "min_J", "min_cell_J", "max_u", "nonfinite",
    "seconds", "negative_eigenvalues",
)  # fmt: skip
_STEP = _table(
    {"load": _number},
    {
        **dict.fromkeys(_VALUES, _number_or_null),
        "converged": _flag,
        "reason": _text,
        "stability": _text,
        "notes": _list(_text),
        "obstacles": _MOVED,
        "bones": _MOVED,
        "rigid": _named(_named(_list(_number, 3))),
        "reactions": _named(_list(_number_or_null)),
        "moments": _named(_list(_number_or_null)),
        "probes": _named(_list(_number_or_null)),
    },
)
_SOLID = _named(_table({}, {"pose": _POSE, "shape": _named(_any)}))
_RECORD = _table(
    {"scene": _text, "material": _material, "steps": _list(_STEP)},
    {
        "element": _text,
        "kinematics": _text,
        "cells": _whole,
        "converged": _flag,
        "status": _text,
        "load_name": _text,
        "load_range": _list(_number, 2),
        "time": _table({"duration": _positive}, {"start": _named(_any)}),
        "obstacles": _SOLID,
        "bones": _SOLID,
        "rigid": _named(_table({"shape": _named(_any), "point": _list(_number, 3)}, {})),
        "cell_groups": _list(_list(_text)),
        "units": _text,
        "modes": _table({"frequencies": _list(_number)}, {}),
        "seconds": _named(_number),
        "peak_memory_mb": _number,
        "processor_seconds": _number,
        "versions": _named(_any),
        "resumed": _list(_number),
        "notes": _list(_table({"kind": _text, "text": _text}, {})),
    },
)

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


#: The kinds of notes: of the loads; of the output folder; an element that locks; points that are
#: inverted; a jump to a state far away within one step; a surface that is deep in an obstacle or
#: another surface, between the points at which contact acts; penalties that yield; forces that are
#: known to their rounding error; an unstable equilibrium; one other than rest though no load acts;
#: nodes outside of the mesh of the run from which this one starts; rigid motions that nothing
#: constrains, or supports without an area; a pressure that is known up to a constant; cells of the
#: mesh that meet without being connected; a motion that gains energy; PETSc options that no solver
#: has; steps that needed a proximal term.
KINDS = (
    "supports",
    "load",
    "folder",
    "locking",
    "inverted",
    "jump",
    "penetration",
    "penalty",
    "rounding",
    "unstable",
    "rest",
    "start",
    "pressure",
    "mesh",
    "energy",
    "options",
    "stabilised",
)
#: Those on how a state was reached, which hold for what starts from it.
NOTES_ON_PATH = ("jump", "start")


class Note(NamedTuple):
    """A note on a result.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    text : str
        One line: what is the matter, and what to do.
    step : int or None
        Number of the step in ``steps`` of run.json, from 0; None: of the scene or of a program.
    values : mapping
        The numbers of the text, by name.
    """

    kind: str
    text: str
    step: int | None = None
    values: Mapping[str, Any] = {}

    def record(self) -> dict[str, Any]:
        """Return the entry of ``notes`` in run.json."""
        return {"kind": self.kind, "step": self.step, "text": self.text, **self.values}


def with_notes(status: str, number: int) -> str:
    """Return a status with the number of notes: "converged, 2 notes"."""
    return f"{status}, {number} note{'s' if number > 1 else ''}" if number else status
