"""Dirichlet conditions: tables of scenes, and objects of programs."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from fem_snh.errors import BadInput, bad_value
from fem_snh.tables.amplitudes import MotionTable
from fem_snh.tables.types import SURFACE, Components, Part, Surface
from fem_snh.tables.validation import Table

#: What the key ``group`` means.
_GROUP = (
    "Physical group of the mesh, by name or number: points, curves, surfaces or volumes; in a "
    "program also a measure."
)
_COMPONENTS = "Components of the displacement that are prescribed."


class Hold(Table):
    """A homogeneous Dirichlet condition: a physical group that does not move.

    At nodes of several groups, as on the edge of two faces, [[move]] overrides [[hold]], and a
    later [[move]] an earlier one. In a program it is one of ``bcs``, of which later ones override:
    ``fem_snh.Hold(group=ds(3))``.
    """

    group: Part = Field(description=_GROUP)
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
    """A Dirichlet condition that moves a physical group rigidly: it is rotated, then translated.

    In a program it is one of ``bcs``: ``fem_snh.Move(group=ds(4), translate=[0.5, 0, 0])``.
    """

    group: Part = Field(description=_GROUP)
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


class Symmetry(Table):
    """A plane surface, or straight curve in two dimensions, whose nodes slide in its plane.

    The displacement's component along the plane's normal is zero: rollers, on a plane of any
    inclination. Several planes are several conditions; at their common edges and corners all hold.
    In a program it is one of ``bcs``: ``fem_snh.Symmetry(group=ds(3))``.
    """

    group: Surface = Field(description=SURFACE)
