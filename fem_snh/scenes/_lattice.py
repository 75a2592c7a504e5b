"""The table ``mesh = { lattice = ..., cell = ... }`` of a scene: a body in a hexahedral lattice."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Discriminator, Field, Tag, model_validator

from fem_snh.choices import LATTICE_PARTS, LATTICE_WEIGHTINGS
from fem_snh.errors import bad_value
from fem_snh.geometry.shapes import ClosedSurface, Shape
from fem_snh.tables.shapes import ShapeChoice
from fem_snh.tables.types import Positive, SurfaceFile
from fem_snh.tables.validation import OneOf, Table, Whole

#: Cubes along a cell's edge: fewer tell no parts apart, more need gigabytes for a body's cells.
_SAMPLES = (2, 16)


#: A file of a closed surface, or the table of a shape; the tags are removed from messages.
Body = Annotated[
    Annotated[ShapeChoice, Tag("a shape")] | Annotated[SurfaceFile, Tag("a surface")],
    Discriminator(lambda body: "a shape" if isinstance(body, dict | ShapeChoice) else "a surface"),
]


Weighting = Annotated[str, OneOf(LATTICE_WEIGHTINGS)]
Parts = Annotated[str, OneOf(LATTICE_PARTS)]


class Lattice(Table):
    """A body in a lattice of equal cubes, which its surface cuts."""

    lattice: Body = Field(
        description="The body: an STL or OBJ file of a closed surface, relative to the scene file; "
        "or a table as `shape` is."
    )
    cell: Positive = Field(description="Edge of a cell [length].")
    weighting: Weighting = Field(
        default=LATTICE_WEIGHTINGS[0],
        description="How energy, mass and weight of a cell count: by the fraction of it that the "
        "body fills, or in full.",
    )
    parts: Parts = Field(
        default=LATTICE_PARTS[0],
        description="Whether parts of the body that pass through one cell without touching have "
        "cells of their own there, separate, or share one, joined.",
    )
    samples: Annotated[int, Whole(*_SAMPLES)] = Field(
        default=4,
        description="Fractions and parts are sampled on this number of cubes along a cell's edge.",
    )
    skin: Annotated[int, Whole(1, 8)] = Field(
        default=2,
        description="The surface of a shape is triangulated on this number of cubes along a "
        "cell's edge; that of a file is the file's.",
    )

    @model_validator(mode="after")
    def _check_skin(self) -> Lattice:
        if isinstance(self.lattice, Path) and self.skin != type(self).model_fields["skin"].default:
            accepted = f"no value, as the surface is that of {self.lattice}"
            raise bad_value("skin", self.skin, accepted)
        return self

    def body(self) -> Shape:
        """Return the body. Reads the file that the table names; raises BadInput if it cannot."""
        return _shape(self.lattice)


class Tetrahedra(Table):
    """A body that tetrahedra fill."""

    surface: Body = Field(
        description="The body: an STL or OBJ file of a closed surface, relative to the scene file; "
        "or a table as `shape` is."
    )
    size: Positive = Field(description="Edge of a tetrahedron [length].")

    def body(self) -> Shape:
        """Return the body. Reads the file that the table names; raises BadInput if it cannot."""
        return _shape(self.surface)


def _shape(body: ShapeChoice | Path) -> Shape:
    """Return the shape of a table, or the surface of a file."""
    return body.shape() if isinstance(body, ShapeChoice) else ClosedSurface.read(body)
