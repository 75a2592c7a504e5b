"""Rigid motions as tables: a rotation, then a translation, in proportion to amplitudes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator

from fem_snh.errors import BadInput, bad_value
from fem_snh.tables.amplitudes import Amplitudes, TableName
from fem_snh.tables.types import Axis, Number, Vector
from fem_snh.tables.validation import Table

Array = npt.NDArray[np.float64]

#: What a key ``translate`` means.
TRANSLATE = "Displacement at amplitude 1 [length]; it is proportional to the amplitude."


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


def rigid_displacement(
    X: Array,
    translate: Sequence[float] | None,
    rotate: Rotate | None,
    amplitude: float,
    turn: float | None = None,
) -> Array:
    r"""Return the displacements of a rotation, followed by a translation.

    .. math:: u(X) = R(\lambda_r\varphi)(X - c) + c - X + \lambda t

    Parameters
    ----------
    X : (n, 3) array
        Reference coordinates [length].
    translate : (3,) sequence, optional
        The translation t at amplitude 1 [length].
    rotate : Rotate, optional
        The rotation.
    amplitude : float
        The amplitude :math:`\lambda` of the motion; without tables the load, from 0 to 1.
    turn : float, optional
        The amplitude :math:`\lambda_r` of the rotation, if it has one of its own.

    Returns
    -------
    (n, 3) array
        Displacements [length], in all components.
    """
    u = np.zeros_like(X, dtype=float)
    if rotate is not None:
        # Rodrigues' formula: importing scipy.spatial takes longer than a small solve.
        axis = np.asarray(rotate.axis) / np.linalg.norm(rotate.axis)
        angle = (amplitude if turn is None else turn) * rotate.angle
        across = np.cross(axis, X - np.asarray(rotate.through))
        u += np.sin(angle) * across + 2 * np.sin(angle / 2) ** 2 * np.cross(axis, across)
    if translate is not None:
        u += amplitude * np.asarray(translate)
    return u


class Movable(Protocol):
    """A table with the keys of a rigid motion."""

    translate: Vector | None
    rotate: Rotate | None
    table: TableName | None


@dataclass(frozen=True)
class ScaledMotion:
    """The rigid motion of a table with ``translate`` and ``rotate``, with its amplitudes.

    Attributes
    ----------
    choice : Movable
        The table.
    amplitude, turn : callable
        Amplitudes of the motion and of its rotation, as functions of the load.
    """

    choice: Any
    amplitude: Callable[[float], float]
    turn: Callable[[float], float]

    @classmethod
    def of(cls, choice: Movable, amplitudes: Amplitudes) -> ScaledMotion:
        """Return the motion of a table."""
        motion = amplitudes.motion(choice.table)
        named = choice.rotate.table if choice.rotate else None
        return cls(choice, motion, amplitudes.motion(named, motion))

    @property
    def group(self) -> str | int:
        """Name or number of the physical group that moves."""
        return self.choice.group

    @property
    def components(self) -> tuple[Axis, ...]:
        """The prescribed components."""
        return self.choice.components

    def displacement(self, X: Array, load: float) -> Array:
        """Return the displacements (n, 3) of points X (n, 3) at a load."""
        amplitude, turn = self.amplitude(load), self.turn(load)
        return rigid_displacement(X, self.choice.translate, self.choice.rotate, amplitude, turn)


def check_motion(table: Movable, file: object) -> None:
    """Raise BadInput for contradictions of the keys of a motion, one of which may be a file."""
    for key in ("translate", "rotate", "table"):
        if file is not None and getattr(table, key) is not None:
            raise BadInput(f"'motion' and '{key}' exclude each other: expected one of them")
