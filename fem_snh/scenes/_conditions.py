"""Tables of a scene that load a body: boundary conditions, dead loads, and the initial state."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator, model_validator

from fem_snh.errors import BadInput, bad_value
from fem_snh.scenes._types import (
    Components,
    GroupKey,
    Matrix,
    NonNegative,
    Number,
    Positive,
    Seed,
    Vector,
)
from fem_snh.scenes._validation import Table

Array = npt.NDArray[np.float64]

_GROUP = "Physical group of the mesh, by name or number: points, curves, surfaces or volumes."
_COMPONENTS = "Components of the displacement that are prescribed."


class Hold(Table):
    """A homogeneous Dirichlet condition: a physical group that does not move."""

    group: GroupKey = Field(description=_GROUP)
    components: Components = Field(default=("x", "y", "z"), description=_COMPONENTS)

    def displacement(self, X: Array, load: float) -> Array:
        """Return zeros of the shape of X (n, 3): see `Move.displacement`."""
        return np.zeros_like(X, dtype=float)


class Rotate(Table):
    """A rotation about an axis, right-handed, in proportion to the load."""

    axis: Vector = Field(description="Direction of the axis; its length does not matter.")
    angle: Number = Field(description="Angle at load 1 [rad].")
    through: Vector = Field(default=(0.0, 0.0, 0.0), description="A point of the axis [length].")

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
        default=None, description="Displacement at load 1 [length]; it is proportional to the load."
    )
    rotate: Rotate | None = Field(default=None, description="Rotation, before the translation.")
    components: Components = Field(default=("x", "y", "z"), description=_COMPONENTS)

    @model_validator(mode="after")
    def _check_motion(self) -> Move:
        if self.translate is None and self.rotate is None:
            raise BadInput("missing key 'translate' or 'rotate': expected one of them, or both")
        return self

    def displacement(self, X: Array, load: float) -> Array:
        r"""Return the prescribed displacements at a load.

        .. math:: u(X) = R(\lambda\varphi)(X - c) + c - X + \lambda t

        Parameters
        ----------
        X : (n, 3) array
            Reference coordinates [length].
        load : float
            The load :math:`\lambda`, from 0 to 1.

        Returns
        -------
        (n, 3) array
            Displacements [length], in all components.
        """
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
    """A dead load on a surface, in proportion to the load."""

    group: GroupKey = Field(description="Physical group of surfaces, by name or number.")
    vector: Vector = Field(description="Force per reference area at load 1 [Pa].")


class Start(Table):
    """The initial displacement of a run; without this table it is zero.

    Prescribed nodes take their prescribed displacement.
    """

    map: Matrix | None = Field(
        default=None, description="Matrix A of an affine map: x = A (X - through) + through."
    )
    through: Vector | None = Field(
        default=None,
        description="Fixed point of the map [length]; "
        "default: the centre of the body's bounding box.",
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

    @model_validator(mode="after")
    def _check_kind(self) -> Start:
        if self.map is not None and self.scatter is not None:
            raise BadInput("'map' and 'scatter' exclude each other: expected one of them")
        if self.through is not None and self.map is None:
            raise BadInput("missing key 'map': expected with 'through', which is its fixed point")
        return self
