"""Amplitudes of loads and motions as functions of the load, and rigid motions scaled by them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from pydantic import Field, PlainSerializer, field_validator

from fem_snh.arrays import Array
from fem_snh.choices import INTERPOLATIONS, LARGEST_NUMBER
from fem_snh.errors import bad_value, check_number, choose
from fem_snh.tables.types import Number, Text, Vector
from fem_snh.tables.validation import Bounded, Expect, OneOf, Table, check_distinct

#: Relative difference below which two numbers of a file are equal but for rounding.
_ROUNDING = 1e-6
_POINTS = "a list of [load, value], two or more, the loads ascending"

Points = Annotated[tuple[tuple[Bounded, Bounded], ...], Field(min_length=2), Expect(_POINTS)]

Function = Callable[[float], float]


def function_name(table: Any) -> str:
    """Return "function NAME", as code cannot be compared, or the name of a table, for JSON."""
    name = getattr(table, "__qualname__", type(table).__name__)
    return f"function {name}" if callable(table) else str(table)


#: The type of a key that gives a load or a motion its amplitude: the name of a [[table]], or in a
#: program a function of the load, of the time [s] in a dynamic problem.
TableName = Annotated[
    Annotated[str, Field(min_length=1)] | Function,
    Expect("the name of a [[table]]"),
    PlainSerializer(function_name, when_used="json-unless-none"),
]
#: Keys of the type `TableName`.
_KEYS = ("table", "load_table")
TABLE = (
    "Name of the [[table]] that is its amplitude; default: the load itself, and of a force in a "
    "scene with [time] 1."
)
MOTION_TABLE = "Name of the [[table]] that is its amplitude; default: the load itself."


class Amplitude(Table):
    """A factor of loads and motions that name it, constant beyond its points."""

    name: Text = Field(description="Name by which loads and motions refer to it.")
    points: Points = Field(
        description="Points [load, value] of the function; in a scene with [time], [time in s, "
        "value]."
    )
    interpolation: Annotated[str, OneOf(INTERPOLATIONS)] = Field(
        default=INTERPOLATIONS[0],
        description="linear between the points, or smooth: a cubic spline through them, whose "
        "velocities and accelerations are continuous, for records that move a body in time by "
        "steps shorter than the distance of the points.",
    )

    @field_validator("points")
    @classmethod
    def _check_ascending(cls, points: tuple[tuple[float, float], ...]) -> Any:
        loads = [load for load, _ in points]
        if any(b <= a for a, b in pairwise(loads)):
            raise bad_value("points", [list(point) for point in points], _POINTS)
        return points

    def value(self, load: float) -> float:
        """Return the factor at a load, or at a time [s] in a scene with ``[time]``."""
        loads, values = zip(*self.points, strict=True)
        if self.interpolation == "linear":
            return float(np.interp(load, loads, values))
        return float(self._spline(np.clip(load, loads[0], loads[-1])))

    def has_kinks(self, step: float) -> bool:
        """Return whether the slope jumps at points with a distance larger than ``step``."""
        loads, values = np.transpose(self.points)
        slopes = np.diff(values) / np.diff(loads)
        kinked = bool(np.ptp(slopes) > _ROUNDING * np.abs(slopes).max())
        return (
            self.interpolation == "linear"
            and kinked
            and step < (1 - _ROUNDING) * np.diff(loads).max()
        )

    @cached_property
    def _spline(self) -> Function:
        """The cubic spline through the points."""
        from scipy.interpolate import CubicSpline

        spline: Function = CubicSpline(*zip(*self.points, strict=True))
        return spline


def check_tables(tables: Sequence[Amplitude], scene: Mapping[str, Any]) -> None:
    """Raise BadInput for two tables of one name, an unknown name, or a table without a use.

    Parameters
    ----------
    tables : sequence of Amplitude
        The scene's tables.
    scene : mapping
        The scene's keys and their values: tables, which may name a table, or lists of tables.
    """
    known = [table.name for table in tables]
    check_distinct("table.name", known, "table")
    references = {key: name for key, name in _references(scene) if isinstance(name, str)}
    for key, name in references.items():
        if not known:
            raise bad_value(key, name, "the name of a [[table]]; the scene has none")
        choose(key, name, known)
    for number, name in enumerate(known):
        if name not in references.values():
            accepted = "a name that the key 'table' of a load or a motion has"
            raise bad_value(f"table.{number}.name", name, accepted)


def _references(tables: Mapping[str, Any], path: str = "") -> Iterable[tuple[str, str | Function]]:
    """Yield each reference to a table: its dotted key, and the table's name or a function."""
    for key, value in tables.items():
        here = f"{path}{key}"
        if key in _KEYS and path:
            if value is not None:
                yield here, value
        elif isinstance(value, Table):
            yield from _references(dict(value), f"{here}.")
        elif isinstance(value, list):
            numbered = {str(i): v for i, v in enumerate(value) if isinstance(v, Table)}
            yield from _references(numbered, f"{here}.")


@dataclass(frozen=True)
class _Factor:
    """An amplitude as a function of the load.

    ``function`` is a function of the load; if ``duration`` [s] is given, of the time.
    """

    function: Function
    duration: float | None = None

    def __call__(self, load: float) -> float:
        """Return the factor at a load; raise BadInput if it is not a finite number."""
        at = load if self.duration is None else load * self.duration
        value = self.function(at)
        check_number(f"table({at:g})", value, -LARGEST_NUMBER, highest=LARGEST_NUMBER)
        return float(value)


def constant(load: float) -> float:
    """Return 1: the amplitude of a force without a table in a scene with ``[time]``."""
    return 1.0


@dataclass(frozen=True)
class Amplitudes:
    """The amplitudes of the loads and motions of a body, as functions of the load.

    Attributes
    ----------
    tables : sequence of Amplitude
        The tables that loads and motions may name.
    duration : float or None
        The time at load 1 [s], if the tables are functions of the time; None if they are functions
        of the load.
    """

    tables: Sequence[Amplitude] = ()
    duration: float | None = None

    def motion(self, table: str | Function | None, default: Function = float) -> Function:
        """Return the amplitude of a motion as a function of the load.

        Amplitudes of the same table compare equal.

        Parameters
        ----------
        table : str, callable or None
            The name of a table; or a function of the load, or of the time [s] with a ``duration``.
        default : callable
            Returned if ``table`` is None.

        Raises
        ------
        BadInput
            For a name that no table has.
        """
        if table is None:
            return default
        if callable(table):
            return _Factor(table, self.duration)
        if not self.tables:
            raise bad_value("table", table, "a function of the load, as there is no [[table]]")
        choose("table", table, [known.name for known in self.tables])
        return _Factor(next(t for t in self.tables if t.name == table).value, self.duration)

    def force(self, table: str | Function | None) -> Function:
        """Return the amplitude of a force; without a table the load, or 1 with a ``duration``."""
        return self.motion(table, float if self.duration is None else constant)


#: The amplitudes of a static body without tables.
LOAD_ITSELF = Amplitudes()


def loads_return(scene: Mapping[str, Any], amplitudes: Amplitudes, steps: int) -> bool:
    """Return whether an amplitude's magnitude is larger at the end of a step than at load 1.

    Parameters
    ----------
    scene : mapping
        The scene's keys and their values, as for `check_tables`.
    amplitudes : Amplitudes
        The scene's amplitudes.
    steps : int
        The number of equal steps.
    """
    functions = [amplitudes.motion(table) for _, table in _references(scene)]
    return any(
        max(abs(function(step / steps)) for step in range(steps + 1)) > abs(function(1.0))
        for function in functions
    )


class Rotate(Table):
    """A rotation about an axis, right-handed, in proportion to the amplitude."""

    axis: Vector = Field(description="Direction of the axis; its length does not matter.")
    angle: Number = Field(description="Angle at amplitude 1 [rad].")
    through: Vector = Field(default=(0.0, 0.0, 0.0), description="A point of the axis [length].")
    table: TableName | None = Field(
        default=None,
        description="Name of the [[table]] that is the rotation's amplitude; "
        "default: the amplitude of the motion.",
    )

    @field_validator("axis")
    @classmethod
    def _check_direction(cls, axis: tuple[float, float, float]) -> tuple[float, float, float]:
        if not 0 < np.linalg.norm(axis) < np.inf:
            raise bad_value("axis", list(axis), "a vector that is not zero, of finite length")
        return axis


class MotionTable(Table):
    """A table with the keys of a rigid motion: a rotation, then a translation."""

    needs = {"table": ("translate", "rotate")}
    translate: Vector | None = Field(
        default=None,
        description="Displacement at amplitude 1 [length]; it is proportional to the amplitude.",
    )
    rotate: Rotate | None = Field(default=None, description="Rotation, before the translation.")
    table: TableName | None = Field(default=None, description=MOTION_TABLE)

    @property
    def is_moved(self) -> bool:
        """Whether the table has a translation or a rotation."""
        return self.translate is not None or self.rotate is not None

    def displacement(self, X: Array, amplitude: float, turn: float | None = None) -> Array:
        r"""Return the displacements of a rotation, followed by a translation.

        .. math:: u(X) = R(\lambda_r\varphi)(X - c) + c - X + \lambda t

        with the rotation's angle :math:`\varphi` and point c, and the translation t.

        Parameters
        ----------
        X : (n, 3) array
            Reference coordinates [length].
        amplitude : float
            The amplitude :math:`\lambda` of the motion; without tables the load, from 0 to 1.
        turn : float, optional
            The amplitude :math:`\lambda_r` of the rotation; default: ``amplitude``.

        Returns
        -------
        (n, 3) array
            Displacements [length].
        """
        u = np.zeros_like(X, dtype=float)
        if self.rotate is not None:
            # Rodrigues' formula: importing scipy.spatial takes longer than a small solve.
            axis = np.asarray(self.rotate.axis) / np.linalg.norm(self.rotate.axis)
            angle = (amplitude if turn is None else turn) * self.rotate.angle
            across = np.cross(axis, X - np.asarray(self.rotate.through))
            u += np.sin(angle) * across + 2 * np.sin(angle / 2) ** 2 * np.cross(axis, across)
        if self.translate is not None:
            u += amplitude * np.asarray(self.translate)
        return u

    def scaled(self, amplitudes: Amplitudes) -> ScaledMotion:
        """Return the motion as a function of the load, by the amplitudes that its keys name."""
        amplitude = amplitudes.motion(self.table)
        turn = amplitudes.motion(self.rotate.table if self.rotate else None, amplitude)
        return ScaledMotion(self, amplitude, turn)


@dataclass(frozen=True)
class ScaledMotion:
    """The motion of a table as a function of the load.

    Attributes
    ----------
    table : MotionTable
        The table.
    amplitude, turn : callable
        Amplitudes of the motion and of its rotation, as functions of the load.
    """

    table: MotionTable
    amplitude: Function
    turn: Function

    def displacement(self, X: Array, load: float) -> Array:
        """Return the displacements (n, 3) of points X (n, 3) at a load."""
        return self.table.displacement(X, self.amplitude(load), self.turn(load))
