"""Tables of a scene that prescribe displacements: boundary conditions and the initial state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator, model_validator

from fem_snh.errors import BadInput, bad_value
from fem_snh.tables.amplitudes import MOTION_TABLE, Amplitudes, TableName
from fem_snh.tables.types import (
    Axis,
    Components,
    GroupKey,
    Matrix,
    NonNegative,
    Number,
    Positive,
    Seed,
    Vector,
)
from fem_snh.tables.validation import Table

Array = npt.NDArray[np.float64]

_GROUP = "Physical group of the mesh, by name or number: points, curves, surfaces or volumes."
_COMPONENTS = "Components of the displacement that are prescribed."


class Hold(Table):
    """A homogeneous Dirichlet condition: a physical group that does not move.

    At nodes of several groups, as on the edge of two faces, [[move]] overrides [[hold]], and a
    later [[move]] an earlier one.
    """

    group: GroupKey = Field(description=_GROUP)
    components: Components = Field(default=("x", "y", "z"), description=_COMPONENTS)

    def displacement(self, X: Array, load: float) -> Array:
        """Return zeros of the shape of X (n, 3): see `Move.displacement`."""
        return np.zeros_like(X, dtype=float)


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


class Move(Table):
    """A Dirichlet condition that moves a physical group rigidly: it is rotated, then translated."""

    group: GroupKey = Field(description=_GROUP)
    translate: Vector | None = Field(
        default=None,
        description="Displacement at amplitude 1 [length]; it is proportional to the amplitude.",
    )
    rotate: Rotate | None = Field(default=None, description="Rotation, before the translation.")
    components: Components = Field(default=("x", "y", "z"), description=_COMPONENTS)
    table: TableName | None = Field(default=None, description=MOTION_TABLE)

    @model_validator(mode="after")
    def _check_motion(self) -> Move:
        if self.translate is None and self.rotate is None:
            raise BadInput("missing key 'translate' or 'rotate': expected one of them, or both")
        return self

    def displacement(self, X: Array, amplitude: float, turn: float | None = None) -> Array:
        """Return the prescribed displacements (n, 3) at an amplitude: see `rigid_displacement`."""
        return rigid_displacement(X, self.translate, self.rotate, amplitude, turn)


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


@dataclass(frozen=True)
class Motion:
    """A `Move` with its amplitudes, as functions of the load.

    Attributes
    ----------
    move : Move
    amplitude, turn : callable
        Amplitudes of the motion and of its rotation.
    """

    move: Move
    amplitude: Callable[[float], float]
    turn: Callable[[float], float]

    @property
    def group(self) -> str | int:
        """Name or number of the physical group."""
        return self.move.group

    @property
    def components(self) -> tuple[Axis, ...]:
        """The prescribed components."""
        return self.move.components

    def displacement(self, X: Array, load: float) -> Array:
        """Return the (n, 3) displacements of reference points X (n, 3) at a load."""
        return self.move.displacement(X, self.amplitude(load), self.turn(load))


def motions(moves: Sequence[Move], amplitudes: Amplitudes) -> list[Motion]:
    """Return motions with their amplitudes."""
    found = []
    for move in moves:
        motion = amplitudes.motion(move.table)
        turn = amplitudes.motion(move.rotate.table if move.rotate else None, motion)
        found.append(Motion(move, motion, turn))
    return found


class Start(Table):
    """The initial displacement and velocity of a run; without this table they are zero.

    Prescribed nodes take their prescribed displacement and velocity.
    """

    map: Matrix | None = Field(
        default=None, description="Matrix A of an affine map: x = A (X - through) + through."
    )
    through: Vector | None = Field(
        default=None,
        description="Fixed point of the map, and a point of the axis of the angular velocity "
        "[length]; default: the centre of the body's bounding box.",
    )
    scatter: Positive | None = Field(
        default=None,
        description="Each node is placed at random in the bounding box, "
        "enlarged to this many times its volume.",
    )
    noise: NonNegative = Field(
        default=0.0, description="Largest random displacement added to each component [length]."
    )
    seed: Seed = Field(default=0, description="Seed of the random numbers.")
    velocity: Vector | None = Field(
        default=None, description="Initial velocity [m/s], of a scene with [time]."
    )
    angular_velocity: Vector | None = Field(
        default=None,
        description="Initial angular velocity [rad/s], of a scene with [time]; "
        "it is added to the velocity.",
    )

    @model_validator(mode="after")
    def _check_kind(self) -> Start:
        if self.map is not None and self.scatter is not None:
            raise BadInput("'map' and 'scatter' exclude each other: expected one of them")
        if self.through is not None and self.map is None and self.angular_velocity is None:
            raise BadInput(
                "missing key 'map': expected with 'through', which is its fixed point; "
                "or 'angular_velocity'"
            )
        return self

    @property
    def displaces(self) -> bool:
        """Whether the body does not start undeformed."""
        return self.map is not None or self.scatter is not None or self.noise > 0

    @property
    def moves(self) -> bool:
        """Whether the body starts with a velocity."""
        return self.velocity is not None or self.angular_velocity is not None
