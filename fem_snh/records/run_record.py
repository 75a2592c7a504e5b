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
from typing import Any, NamedTuple, TypeGuard

from fem_snh.errors import BadInput, shown
from fem_snh.files import read_text

#: The content of run.json, or of a part of it such as the row of a step.
Record = dict[str, Any]


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


def is_number(value: object) -> bool:
    """Return whether a value is a finite number."""
    return _is_number(value) and isfinite(value)


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


_NUMBER, _NUMBER_OR_NULL, _TEXT, _FLAG = "a number", "a number or null", "a text", "true or false"
_POSITIVE, _WHOLE = "a number > 0", "a whole number"
#: Tests of values. A step that failed may have an infinite residual or energy, which is null.
_TESTS: dict[str, Callable[[Any], bool]] = {
    _NUMBER: is_number,
    _NUMBER_OR_NULL: lambda value: value is None or _is_number(value),
    _TEXT: lambda value: isinstance(value, str),
    _FLAG: lambda value: isinstance(value, bool),
    _POSITIVE: lambda value: is_number(value) and value > 0,
    _WHOLE: lambda value: isinstance(value, int) and not isinstance(value, bool),
}
#: What is expected: a key of `_TESTS`; a list (item,) of any length, or (item, length); a table,
#: which may have other keys, with "?" after an optional key, and "*" for any.
_Form = str | tuple[Any, ...] | Mapping[str, Any]

_MATERIAL = {"name": _TEXT, "nu": _NUMBER, "E?": _NUMBER, "parameters?": {}}
_POSE = ((_NUMBER, 4), 3)
_VALUES = (
    "time", "newton", "clamped", "linear", "lbfgs", "residual", "energy", "kinetic", "elastic",
    "potential", "dissipated", "volume_ratio", "min_J", "min_cell_J", "max_u", "nonfinite",
    "seconds", "negative_eigenvalues",
)  # fmt: skip
_STEP = {
    "load": _NUMBER,
    **{f"{name}?": _NUMBER_OR_NULL for name in _VALUES},
    "converged?": _FLAG,
    "reason?": _TEXT,
    "stability?": _TEXT,
    "notes?": (_TEXT,),
    **{key: {"*": {"pose?": _POSE}} for key in ("obstacles?", "bones?")},
    "rigid?": {"*": {"*": (_NUMBER, 3)}},
    **{key: {"*": (_NUMBER_OR_NULL,)} for key in ("reactions?", "moments?", "probes?")},
}
_RECORD = {
    "scene": _TEXT,
    "material": _MATERIAL,
    "steps": (_STEP,),
    **dict.fromkeys(("element?", "kinematics?", "status?", "load_name?", "units?"), _TEXT),
    **dict.fromkeys(("peak_memory_mb?", "processor_seconds?"), _NUMBER),
    "cells?": _WHOLE,
    "converged?": _FLAG,
    "load_range?": (_NUMBER, 2),
    "time?": {"duration": _POSITIVE, "start?": {}},
    **{key: {"*": {"pose?": _POSE, "shape?": {}}} for key in ("obstacles?", "bones?")},
    "rigid?": {"*": {"shape": {}, "point": (_NUMBER, 3)}},
    "cell_groups?": ((_TEXT,),),
    "modes?": {"frequencies": (_NUMBER,)},
    "seconds?": {"*": _NUMBER},
    "versions?": {},
    "resumed?": (_NUMBER,),
    "notes?": ({"kind": _TEXT, "text": _TEXT},),
}


def problem(record: object) -> str:
    """Return what is wrong with a record as ``key = value: expected ...``, or ""."""
    several = isinstance(record, dict) and record.get("material")
    materials = (_MATERIAL,) if several and isinstance(several, list) else _MATERIAL
    return _mistake("", record, _RECORD | {"material": materials})


def _mistake(key: str, value: Any, form: _Form) -> str:
    """Return the first mistake in a value, or ""."""
    accepted = ""
    items: list[tuple[str, Any, _Form]] = []
    if isinstance(form, str):
        accepted = "" if _TESTS[form](value) else form
    elif isinstance(form, tuple):
        item, *length = form
        if not isinstance(value, list) or (length and len(value) != length[0]):
            accepted = " of ".join(["a list", *map(str, length)])
        else:
            items = [(f"{key}[{i}]", entry, item) for i, entry in enumerate(value)]
    elif not isinstance(value, dict):
        accepted = "a table"
    else:
        required = (name for name in form if name != "*" and not name.endswith("?"))
        if missing := next((name for name in required if name not in value), ""):
            return f"{key}.{missing}: missing".removeprefix(".")
        for name, entry in value.items():
            known = next((n for n in (name, f"{name}?", "*") if n in form), None)
            if known:
                items.append((f"{key}.{name}", entry, form[known]))
    if accepted:
        return f"{key.removeprefix('.') or 'content'} = {shown(value)}: expected {accepted}"
    return next(filter(None, (_mistake(*item) for item in items)), "")


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
    """Return the SI unit of a column of a step's `flat` row, or "": also of a quotient of two."""
    if name not in flat(step):
        return ""
    body = name.removesuffix(".error")
    body = next((body.removesuffix(end) for end in (".x", ".y", ".z") if body.endswith(end)), body)
    if body in step.get("probes", {}):
        return "m"
    owner, _, kind = body.rpartition(".")
    if kind == "volume" and owner in step.get("cavities", {}):
        return "m^3"
    return _UNITS.get(kind, "")


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


#: Kinds of notes on how a state was reached, which hold for what starts from it.
NOTES_ON_PATH = ("jump", "start")


class Note(NamedTuple):
    """A note on a result.

    Attributes
    ----------
    kind : str
        ``supports`` (rigid motions that nothing constrains, or supports without an area),
        ``load``, ``folder``, ``locking``, ``inverted``, ``jump`` (a state far away within one
        step), ``penetration`` (between the points at which contact acts), ``penalty`` (one that
        yields), ``rounding`` (forces known to their rounding error), ``unstable``, ``rest`` (an
        equilibrium other than rest without a load), ``start`` (nodes outside of the mesh of the run
        from which this one starts), ``pressure`` (known up to a constant), ``mesh`` (cells that
        meet without being connected), ``energy`` (a motion that gains it), ``options`` (of PETSc
        that no solver has) or ``stabilised`` (steps that needed a proximal term).
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
