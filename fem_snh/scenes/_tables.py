"""Amplitudes of a scene's loads and motions, as functions of the load."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from fem_snh.errors import bad_value, choose
from fem_snh.scenes._types import Text
from fem_snh.scenes._validation import Bounded, Expect, Table

_POINTS = "a list of [load, value], two or more, the loads ascending"

Points = Annotated[tuple[tuple[Bounded, Bounded], ...], Field(min_length=2), Expect(_POINTS)]

#: The key of a load or a motion that names a table.
TableName = Annotated[str, Field(min_length=1), Expect("the name of a [[table]]")]
TABLE = (
    "Name of the [[table]] that is its amplitude; default: the load itself, and of a force in a "
    "scene with [time] 1."
)
MOTION_TABLE = "Name of the [[table]] that is its amplitude; default: the load itself."


class Amplitude(Table):
    """A factor of loads and motions that name it: linear between points, constant beyond them."""

    name: Text = Field(description="Name by which loads and motions refer to it.")
    points: Points = Field(
        description="Points [load, value] of the piecewise linear function; in a scene with "
        "[time], [time in s, value]."
    )

    @field_validator("points")
    @classmethod
    def _check_ascending(cls, points: tuple[tuple[float, float], ...]) -> Any:
        loads = [load for load, _ in points]
        if any(b <= a for a, b in pairwise(loads)):
            raise bad_value("points", [list(point) for point in points], _POINTS)
        return points

    def value(self, load: float) -> float:
        """Return the factor at a load, or at a time in a scene with ``[time]``."""
        loads, values = zip(*self.points, strict=True)
        return float(np.interp(load, loads, values))


def check_tables(tables: Sequence[Amplitude], scene: Mapping[str, Any]) -> None:
    """Raise BadInput if two tables have one name, or if a name refers to none of them.

    Parameters
    ----------
    tables : sequence of Amplitude
        The scene's tables.
    scene : mapping
        The scene's keys and their values: loads and motions, or lists of them.
    """
    known = [table.name for table in tables]
    for name in known:
        if known.count(name) > 1:
            raise bad_value("table.name", name, "a different name for each table")
    for key, name in _references(scene):
        if not known:
            raise bad_value(key, name, "the name of a [[table]]; the scene has none")
        choose(key, name, known)


def _references(tables: Mapping[str, Any], path: str = "") -> Iterable[tuple[str, str]]:
    """Return the dotted keys and the names of all tables that are referred to."""
    for key, value in tables.items():
        here = f"{path}{key}"
        if key == "table" and path:
            if value is not None:
                yield here, value
        elif isinstance(value, Table):
            yield from _references(dict(value), f"{here}.")
        elif isinstance(value, list):
            numbered = {str(i): v for i, v in enumerate(value) if isinstance(v, Table)}
            yield from _references(numbered, f"{here}.")


@dataclass(frozen=True)
class TimeAmplitude:
    """The amplitude of a table in time, as a function of the load.

    Attributes
    ----------
    table : Amplitude
        The table, with times [s].
    duration : float
        The time of load 1 [s].
    """

    table: Amplitude
    duration: float

    def __call__(self, load: float) -> float:
        """Return the factor at a load."""
        return self.table.value(load * self.duration)


def constant(load: float) -> float:
    """Return 1: the amplitude of a force without a table in a scene with ``[time]``."""
    return 1.0


def amplitude(
    tables: Sequence[Amplitude],
    name: str | None,
    default: Callable[[float], float] = float,
    duration: float | None = None,
) -> Callable[[float], float]:
    """Return the function of the load that a key ``table`` names; ``default`` without a name.

    Tables are in time if there is a ``duration``, the time of load 1 [s].
    """
    if name is None:
        return default
    table = next(table for table in tables if table.name == name)
    return table.value if duration is None else TimeAmplitude(table, duration)
