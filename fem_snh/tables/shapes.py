"""The shapes of a scene's obstacles, bones and lattices, as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field, create_model, model_validator

from fem_snh.geometry.shapes import ClosedSurface, Shape, from_record
from fem_snh.records.run_files import surface_copy
from fem_snh.tables.types import Flag, Positive, Vector
from fem_snh.tables.validation import Bounded, BoundedPositive, Expect, Table

Size = Annotated[
    tuple[BoundedPositive, ...],
    Field(min_length=3, max_length=3),
    Expect("three numbers > 0, [x, y, z]"),
]


class _ShapeTable(Table):
    """The base of the tables of shapes; ``kind`` is the shape's key in scenes and run.json."""

    kind: ClassVar[str]

    @model_validator(mode="after")
    def _check_shape(self) -> _ShapeTable:
        # It raises BadInput for values that contradict each other.
        from_record({self.kind: dict(self)})
        return self


class PlaneShape(_ShapeTable):
    """The half-space below a plane."""

    kind = "plane"
    point: Vector = Field(default=(0.0, 0.0, 0.0), description="A point of the plane [length].")
    normal: Vector = Field(
        default=(0.0, 0.0, 1.0),
        description="Direction out of the obstacle, to the body; its length does not matter.",
    )


class SphereShape(_ShapeTable):
    """A ball."""

    kind = "sphere"
    center: Vector = Field(description="The centre [length].")
    radius: Positive = Field(description="The radius [length].")


#: The keys of an axis: 'from' is a word of Python, which no class body can define.
_ENDS: dict[str, Any] = {
    "from": (Vector, Field(description="One end of the axis [length].")),
    "to": (Vector, Field(description="The other end [length].")),
}
#: Any: mypy knows no class that is made at run time, and calls one that extends it an error (misc).
_Axis: Any = create_model("_Axis", __base__=_ShapeTable, **_ENDS)


class CylinderShape(_Axis):  # type: ignore[misc]  # made by pydantic at run time
    """A circular cylinder with flat ends, or an infinite one."""

    kind = "cylinder"
    radius: Positive = Field(description="The radius [length].")
    infinite: Flag = Field(default=False, description="Whether it goes on beyond both ends.")


class CapsuleShape(_Axis):  # type: ignore[misc]  # made by pydantic at run time
    """All points within a radius of a segment: a cylinder with round ends."""

    kind = "capsule"
    radius: Positive = Field(description="The radius [length].")


class BoxShape(_ShapeTable):
    """A rectangular box."""

    kind = "box"
    center: Vector = Field(description="The centre [length].")
    size: Size = Field(description="Lengths of the edges, [x, y, z] [length].")
    rotation: Vector = Field(
        default=(0.0, 0.0, 0.0),
        description="Rotation vector about the centre: axis times angle [rad].",
    )


Corners = Annotated[
    tuple[tuple[Bounded, Bounded], ...], Expect("three or more points, [[x, y], ...]")
]


class PolygonShape(_ShapeTable):
    """A polygon in the plane (x, y), of a body in two dimensions; in three an infinite prism."""

    kind = "polygon"
    points: Corners = Field(
        description="The corners in turn, [[x, y], ...] [length]; the last edge closes it."
    )


#: A list of one or more shapes; a forward reference, as `ShapeChoice` has keys of this type.
_Shapes = Annotated[list["ShapeChoice"], Field(min_length=1)]


class SmoothUnionShape(Table):
    """The union of shapes with rounded seams."""

    shapes: _Shapes = Field(description="The shapes, each a table as `shape` is.")
    blend: Positive = Field(
        description="How far outside of two surfaces the union's is where they meet [length]."
    )


class ShapeChoice(Table):
    """The shape of an obstacle, a bone or a lattice: one key, which names the kind of the shape."""

    one_of = (
        "plane", "sphere", "cylinder", "capsule", "box", "polygon", "union", "smooth_union",
    )  # fmt: skip
    plane: PlaneShape | None = Field(default=None, description="A half-space: flat ground.")
    sphere: SphereShape | None = Field(default=None, description="A ball.")
    cylinder: CylinderShape | None = Field(default=None, description="A circular cylinder.")
    capsule: CapsuleShape | None = Field(default=None, description="A cylinder with round ends.")
    box: BoxShape | None = Field(default=None, description="A rectangular box.")
    polygon: PolygonShape | None = Field(
        default=None, description="A polygon, for meshes of two dimensions."
    )
    union: _Shapes | None = Field(
        default=None, description="All points of several shapes, a list of tables as `shape` is."
    )
    smooth_union: SmoothUnionShape | None = Field(
        default=None, description="The same with rounded seams."
    )

    @property
    def given(self) -> dict[str, Any]:
        """The key that is set, with its table; the key ``union`` has a list of tables."""
        return {key: table for key, table in self if table is not None}

    def shape(self) -> Shape:
        """Return the shape that the table describes."""
        return from_record(self.record())

    def record(self) -> dict[str, Any]:
        """Return the shape's entry in run.json: a table of one key, as in the scene."""
        return self.model_dump(mode="json", exclude_none=True)


def shape_of(choice: ShapeChoice | Path) -> Shape:
    """Return the shape that a table describes, or the closed surface in an STL or OBJ file.

    Raises
    ------
    BadInput
        For a file that cannot be read or is not valid.
    """
    return choice.shape() if isinstance(choice, ShapeChoice) else ClosedSurface.read(choice)


def shape_record(key: str, number: int, choice: ShapeChoice | Path) -> dict[str, Any]:
    """Return the entry in run.json of the shape or the surface of table ``number`` of ``key``."""
    if isinstance(choice, ShapeChoice):
        return choice.record()
    return {"surface": surface_copy(key, number, choice)}
