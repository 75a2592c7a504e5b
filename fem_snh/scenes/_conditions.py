"""What is done to a body: held, moved, pulled, begun elsewhere than at rest."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, field_validator, model_validator

from fem_snh.errors import BadInput
from fem_snh.scenes._types import Components, GroupKey, Matrix, Number, Vector, Volume
from fem_snh.scenes._validation import Expect, Finite, Table


class Hold(Table):
    """A physical group that stays where it is, in some components."""

    group: GroupKey
    components: Components = ("x", "y", "z")

    def displacement(self, X: np.ndarray, load: float) -> np.ndarray:
        """Zero: see `Move.displacement`."""
        return np.zeros_like(X, dtype=float)


class Rotate(Table):
    """A rotation by ``angle`` [rad] at load 1, right-handed about ``axis`` through a point."""

    axis: Vector
    angle: Number
    through: Vector = (0.0, 0.0, 0.0)

    @field_validator("axis")
    @classmethod
    def _direction(cls, axis: tuple[float, float, float]) -> tuple[float, float, float]:
        if not np.linalg.norm(axis) > 0:
            raise BadInput(f"{list(axis)} has no direction: expected a non-zero vector")
        return axis


class Move(Table):
    """A physical group that moves rigidly: turned first, then shifted, both with the load."""

    group: GroupKey
    translate: Vector | None = None
    rotate: Rotate | None = None
    components: Components = ("x", "y", "z")

    @model_validator(mode="after")
    def _moves(self) -> Move:
        if self.translate is None and self.rotate is None:
            raise BadInput("a move needs 'translate', 'rotate' or both")
        return self

    def displacement(self, X: np.ndarray, load: float) -> np.ndarray:
        """Displacements (n, 3) of the reference points X (n, 3) at a load: R X - X + load t."""
        u = np.zeros_like(X, dtype=float)
        if self.rotate is not None:
            from scipy.spatial.transform import Rotation

            axis = np.asarray(self.rotate.axis) / np.linalg.norm(self.rotate.axis)
            arm = X - np.asarray(self.rotate.through)
            u += Rotation.from_rotvec(load * self.rotate.angle * axis).apply(arm) - arm
        if self.translate is not None:
            u += load * np.asarray(self.translate)
        return u


class Traction(Table):
    """A dead load [Pa, per reference area] on a surface group, growing with the load."""

    group: GroupKey
    vector: Vector


class Start(Table):
    """Where a run begins that does not begin at rest: prescribed nodes are where they must be.

    Either ``map``, a matrix: x = map (X - through) + through, ``through`` being the middle of the
    body's bounding box if not given; or ``scatter``: every node anywhere in the bounding box
    blown up to this many times its volume. Then ``noise``: moved by up to this [length] in x, y and
    z. ``seed`` chooses the random numbers.
    """

    map: Matrix | None = None
    through: Vector | None = None
    scatter: Volume | None = None
    noise: Annotated[Finite, Field(ge=0), Expect("a number >= 0 (a length)")] = 0.0
    seed: Annotated[int, Field(strict=True, ge=0), Expect("a whole number, 0 or more")] = 0

    @model_validator(mode="after")
    def _one(self) -> Start:
        if self.map is not None and self.scatter is not None:
            raise BadInput("'map' and 'scatter' are two ways to begin: give one of them")
        if self.through is not None and self.map is None:
            raise BadInput("'through' is a fixed point of a 'map', and there is none")
        return self
