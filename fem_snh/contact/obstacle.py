"""Rigid obstacles: shapes in motion that the body touches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, model_validator

from fem_snh.contact.contact import ContactTable
from fem_snh.errors import BadInput, bad_value, on_every
from fem_snh.geometry.motions import MovingShape, RigidMotion, read_motion
from fem_snh.geometry.motions.moving import DisplacementMotion
from fem_snh.geometry.shapes import ClosedSurface
from fem_snh.tables.amplitudes import MOTION_TABLE, Amplitudes, TableName
from fem_snh.tables.motions import TRANSLATE, Rotate, ScaledMotion, check_motion
from fem_snh.tables.shapes import ShapeChoice
from fem_snh.tables.types import FilePath, NonNegative, Surface, Text, Vector
from fem_snh.tables.validation import Expect
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term

#: Keys of files, whose paths are relative to the scene file.
FILES = ("surface", "motion")


StlFile = Annotated[FilePath, Expect("the path of an STL file")]
CsvFile = Annotated[FilePath, Expect("the path of a CSV file")]


class Obstacle(Feature, ContactTable):
    """A rigid obstacle, which may move: the body's surface does not enter it."""

    key = "obstacle"
    name: Text | None = Field(
        default=None, description="Name in the results; default: obstacle_0, obstacle_1, ..."
    )
    shape: ShapeChoice | None = Field(default=None, description="Its shape, or 'surface'.")
    surface: StlFile | None = Field(
        default=None,
        description="STL file of a closed surface, instead of 'shape'; "
        "its path is relative to the scene file.",
    )
    translate: Vector | None = Field(default=None, description=TRANSLATE)
    rotate: Rotate | None = Field(default=None, description="Rotation, before the translation.")
    table: TableName | None = Field(default=None, description=MOTION_TABLE)
    motion: CsvFile | None = Field(
        default=None,
        description="CSV file of poses, instead of 'translate' and 'rotate'; "
        "its path is relative to the scene file.",
    )
    group: Surface | None = Field(
        default=None,
        description="Physical group of the body's surfaces that may touch it, by name or number, "
        "in a program a measure ds(...); default: the whole boundary.",
    )
    friction: NonNegative = Field(default=0.0, description="Coulomb's coefficient of friction.")

    @model_validator(mode="after")
    def _check_keys_together(self) -> Self:
        if (self.shape is None) == (self.surface is None):
            found = "none" if self.shape is None else "both"
            raise BadInput(f"expected one of the keys shape, surface; found {found}")
        check_motion(self, self.motion)
        return self

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput if two have the same name."""
        names(features)

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term of all obstacles. Collective.

        Raises
        ------
        BadInput
            On every rank, for a file that cannot be read, or a group that is no surface.
        """
        from fem_snh.contact.obstacle_contact import ObstacleContact, RigidContact  # imports PETSc

        shapes = on_every(body.domain.comm, lambda: read_obstacles(features, body.amplitudes))
        contacts = []
        for name, table, shape in zip(names(features), features, shapes, strict=True):
            facets = None if table.group is None else body.facets("obstacle.group", table.group)
            tolerance = table.absolute_tolerance(body.volume)
            method = table.friction, table.stiffness, tolerance, table.augmented, facets
            contacts.append(RigidContact(name, shape, *method, body.motion is None))
        term = ObstacleContact(body.V, body.regions, contacts)
        motion = body.motion
        for pair in term.pairs:
            pair.linearised = motion is not None and motion.integrator.name == "semi_implicit"
        return [term]


def read_obstacles(choices: Sequence[Obstacle], amplitudes: Amplitudes) -> list[MovingShape]:
    """Return the obstacles with their motions; read the files that they name.

    Parameters
    ----------
    choices : sequence of Obstacle
        The scene's tables.
    amplitudes : Amplitudes
        The scene's amplitudes.

    Raises
    ------
    BadInput
        One line, for a file that cannot be read or is not valid.
    """
    found = []
    for choice in choices:
        shape = choice.shape.shape() if choice.shape else ClosedSurface.read(str(choice.surface))
        motion: RigidMotion | None = None
        if choice.motion is not None:
            motion = read_motion(choice.motion, amplitudes.duration)
        elif choice.translate is not None or choice.rotate is not None:
            motion = DisplacementMotion(ScaledMotion.of(choice, amplitudes).displacement)
        found.append(MovingShape(shape, motion))
    return found


def names(choices: Sequence[Obstacle]) -> list[str]:
    """Return the obstacles' names. Raises BadInput if two have the same."""
    found = [choice.name or f"obstacle_{i}" for i, choice in enumerate(choices)]
    for name in found:
        if found.count(name) > 1:
            raise bad_value("obstacle.name", name, "a different name for each obstacle")
    return found
