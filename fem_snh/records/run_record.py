"""Check the content of run.json, which may be damaged or of other origin, before it is used."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput, shown
from fem_snh.files import read_text

#: Returns what is wrong with the value of a key, as text, or "".
Check = Callable[[str, object], str]


def load_record(path: Path) -> dict[str, Any]:
    """Return the content of a run.json.

    Raises
    ------
    BadInput
        If it cannot be read, or is not the record of a run.
    """
    try:
        record = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
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
