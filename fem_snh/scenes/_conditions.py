"""Tables of a scene that prescribe displacements: boundary conditions and the initial state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from fem_snh.errors import BadInput, bad_value
from fem_snh.tables.amplitudes import MotionTable
from fem_snh.tables.types import (
    Components,
    FilePath,
    GroupKey,
    Matrix,
    NonNegative,
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

    @model_validator(mode="before")
    @classmethod
    def _check_table(cls, data: Any) -> Any:
        if isinstance(data, dict) and "table" in data:
            accepted = (
                "no table: a [[hold]] lasts for the whole run; to set a part free, move it by a "
                "force that a table takes back to zero, of [[rigid]] or [[traction]]"
            )
            raise bad_value("table", data["table"], accepted)
        return data


class Move(MotionTable):
    """A Dirichlet condition that moves a physical group rigidly: it is rotated, then translated."""

    group: GroupKey = Field(description=_GROUP)
    components: Components = Field(default=("x", "y", "z"), description=_COMPONENTS)

    @model_validator(mode="after")
    def _check_motion(self) -> Move:
        if not self.is_moved:
            raise BadInput("missing key 'translate' or 'rotate': expected one of them, or both")
        for axis, value in zip("xyz", self.translate or (), strict=False):
            if value and axis not in self.components:
                accepted = f"zero along {axis}, which 'components' does not name"
                raise bad_value("translate", list(self.translate or ()), accepted)
        return self


class Start(Table):
    """The initial displacement and velocity of a run; without this table they are zero.

    Prescribed nodes take their prescribed displacement and velocity. From the state of another run
    they go to their prescribed displacement in proportion to the load.
    """

    excludes = {"run": ("map", "scatter", "noise"), "map": ("scatter",)}
    needs = {
        "step": ("run",),
        "through": ("map", "angular_velocity"),
        "seed": ("scatter", "noise"),
    }
    run: FilePath | None = Field(
        default=None,
        description="Folder of another run, relative to this file, whose displacement is the "
        "start; its mesh may be another one of the same body.",
    )
    step: int = Field(
        default=-1,
        description="Number of its stored state: 0 is its start, -1 its last.",
    )

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

    @property
    def files(self) -> dict[str, Path]:
        """The record of the other run, which is not to be replaced by this one."""
        return {"run": self.run / "run.json"} if self.run is not None else {}

    @property
    def displaces(self) -> bool:
        """Whether the body starts with a displacement that this table itself states."""
        return self.map is not None or self.scatter is not None or self.noise > 0

    @property
    def moves(self) -> bool:
        """Whether the body starts with a velocity."""
        return self.velocity is not None or self.angular_velocity is not None
