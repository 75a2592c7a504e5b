"""Rigid obstacles: shapes in motion that the body touches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field, model_validator

from fem_snh.contact.contact import ContactTable
from fem_snh.errors import BadInput, bad_value, on_every
from fem_snh.geometry.motions import MovingShape, RigidMotion, read_motion
from fem_snh.geometry.motions.moving import DisplacementMotion
from fem_snh.geometry.shapes import ClosedSurface
from fem_snh.output_fields import AT_OBSTACLES, OutputField
from fem_snh.tables.amplitudes import MOTION_TABLE, Amplitudes, TableName
from fem_snh.tables.motions import TRANSLATE, Rotate, ScaledMotion, check_motion
from fem_snh.tables.shapes import ShapeChoice
from fem_snh.tables.types import FilePath, NonNegative, Surface, Text, Vector
from fem_snh.tables.validation import Expect
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term

StlFile = Annotated[FilePath, Expect("the path of an STL file")]
CsvFile = Annotated[FilePath, Expect("the path of a CSV file")]


class Obstacle(Feature, ContactTable):
    """A rigid obstacle, which may move: the body's surface does not enter it."""

    key = "obstacle"
    nodal_fields: ClassVar[Mapping[str, OutputField]] = AT_OBSTACLES
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
        description="Physical group of the body's surfaces that may touch it, by name or number; "
        "in a program a measure ds(...); default: the whole boundary.",
    )
    friction: NonNegative = Field(default=0.0, description="Coulomb's coefficient of friction.")
    name: Text | None = Field(
        default=None, description="Name in the results; default: obstacle_0, obstacle_1, ..."
    )

    @model_validator(mode="after")
    def _check_keys_together(self) -> Obstacle:
        if (self.shape is None) == (self.surface is None):
            found = "none" if self.shape is None else "both"
            raise BadInput(f"expected one of the keys shape, surface; found {found}")
        check_motion(self, self.motion)
        return self

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput if two obstacles have one name."""
        names(features)

    def moving(self, amplitudes: Amplitudes) -> MovingShape:
        """Return the shape with its motion; read the files that they name.

        Raises
        ------
        BadInput
            One line, for a file that cannot be read or is not valid.
        """
        shape = self.shape.shape() if self.shape else ClosedSurface.read(str(self.surface))
        motion: RigidMotion | None = None
        if self.motion is not None:
            motion = read_motion(self.motion, amplitudes.duration)
        elif self.translate is not None or self.rotate is not None:
            motion = DisplacementMotion(ScaledMotion.of(self, amplitudes).displacement)
        return MovingShape(shape, motion)

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term of all obstacles. Collective."""
        from fem_snh.contact.obstacle_contact import ObstacleContact, RigidContact  # imports PETSc

        comm = body.domain.comm
        shapes = on_every(comm, lambda: [o.moving(body.amplitudes) for o in features])
        contacts = []
        for name, obstacle, shape in zip(names(features), features, shapes, strict=True):
            group, tolerance = obstacle.group, obstacle.absolute_tolerance(body.volume)
            facets = None if group is None else body.facets("obstacle.group", group)
            law = obstacle.friction, obstacle.stiffness, tolerance, obstacle.augmented
            contacts.append(RigidContact(name, shape, *law, facets, body.motion is None))
        term = ObstacleContact(body.V, body.regions, contacts)
        for pair in term.pairs:
            pair.linearised = bool(body.motion and body.motion.integrator.name == "semi_implicit")
        return [term]

    @classmethod
    def describe(cls, features: Sequence[Self], terms: Sequence[Any]) -> Mapping[str, Any]:
        """Return the obstacles by name, as run.json has them before the first step.

        Each has its ``shape``, a table of one key as in the scene (a surface by its file's name in
        the folder), ``friction``, ``method``, and ``pose``, the three rows [R | c] of its pose at
        load 0.
        """
        found = {}
        for i, (name, obstacle) in enumerate(zip(names(features), features, strict=True)):
            shape = obstacle.shape.record() if obstacle.shape else {"surface": file_name(i)}
            found[name] = {
                "shape": shape,
                "friction": obstacle.friction,
                "method": obstacle.method,
                "pose": terms[0].contacts[i].obstacle.affine(0.0),
            }
        return {"obstacles": found}


def names(obstacles: Sequence[Obstacle]) -> list[str]:
    """Return the obstacles' names. Raises BadInput if two have the same."""
    found = [obstacle.name or f"obstacle_{i}" for i, obstacle in enumerate(obstacles)]
    for name in found:
        if found.count(name) > 1:
            raise bad_value("obstacle.name", name, "a different name for each obstacle")
    return found


def file_name(number: int) -> str:
    """Return the name of an obstacle's STL file in the folder of a run."""
    return f"obstacle_{number}.stl"
