"""The scene's table ``[[obstacle]]``: a rigid shape, its motion, and the contact with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from pydantic import Field

from fem_snh.contact.contact_tables import ContactTable
from fem_snh.errors import bad_value, on_every
from fem_snh.geometry.motion_files import read_motion
from fem_snh.geometry.motions import DisplacementMotion, Motion, MovingShape
from fem_snh.geometry.shapes import Box, Revolved
from fem_snh.records.output_fields import AT_OBSTACLES, OutputField
from fem_snh.tables.amplitudes import Amplitudes, MotionTable
from fem_snh.tables.shapes import ShapeChoice, shape_of, shape_record
from fem_snh.tables.types import CsvFile, NonNegative, Surface, SurfaceFile, Text
from fem_snh.tables.validation import check_distinct
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.assembly.kinematics import Kinematics
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term


class Obstacle(Feature, ContactTable, MotionTable):
    """A rigid obstacle, which may move: the body's surface does not enter it."""

    key, planar = "obstacle", True
    one_of = ("shape", "surface")
    excludes = {"motion": ("translate", "rotate", "table")}
    nodal_fields: ClassVar[Mapping[str, OutputField]] = AT_OBSTACLES
    shape: ShapeChoice | None = Field(default=None, description="Its shape; or 'surface'.")
    surface: SurfaceFile | None = Field(
        default=None,
        description="STL or OBJ file of a closed surface, instead of 'shape'; "
        "its path is relative to the scene file.",
    )
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

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput if two obstacles have the same name."""
        names(features)

    @classmethod
    def goals(cls, features: Sequence[Self]) -> Sequence[str]:
        """Return each obstacle's ``NAME.force``: its force on the body."""
        return [f"{name}.force" for name in names(features)]

    @property
    def _solid(self) -> ShapeChoice | Path:
        """The table of the shape, or the file of its surface."""
        solid = self.shape or self.surface
        assert solid
        return solid

    def moving(self, amplitudes: Amplitudes) -> MovingShape:
        """Return the shape with its motion; read the files of the surface and the motion.

        Raises
        ------
        BadInput
            If a file cannot be read or is not valid; the message is one line.
        """
        motion: Motion | None = None
        if self.motion is not None:
            motion = read_motion(self.motion, amplitudes.duration)
        elif self.is_moved:
            motion = DisplacementMotion(self.scaled(amplitudes).displacement)
        return MovingShape(shape_of(self._solid), motion)

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one `ObstacleContact` for all obstacles. Collective."""
        from fem_snh.contact.obstacle_contact import ObstacleContact, RigidContact  # imports PETSc

        comm, kinematics = body.domain.comm, body.kinematics
        shapes = on_every(comm, lambda: [o.moving(body.amplitudes) for o in features])
        if kinematics.dim == 2:
            shapes = [_in_plane(kinematics, *pair) for pair in zip(names(features), shapes)]
        contacts = []
        for name, obstacle, shape in zip(names(features), features, shapes, strict=True):
            group, tolerance = obstacle.group, obstacle.absolute_tolerance(body.length)
            facets = None if group is None else body.facets("obstacle.group", group)
            law = obstacle.friction, obstacle.stiffness, tolerance, obstacle.augmented
            contacts.append(RigidContact(name, shape, *law, facets, body.motion is None))
        term = ObstacleContact(body.V, body.regions, contacts, kinematics)
        for pair in term.pairs:
            pair.linearised = bool(body.motion and body.motion.integrator.name == "semi_implicit")
        return [term]

    @classmethod
    def describe(cls, features: Sequence[Self], terms: Sequence[Any]) -> Mapping[str, Any]:
        """Return ``{"obstacles": {name: row}}``, which run.json has before the first step.

        A row has ``shape``, a table of one key as in the scene (a surface by its file's name in the
        results), ``friction``, ``method``, and ``pose``, the rows [R | c] of the pose at load 0.
        """
        found = {}
        for i, (name, obstacle) in enumerate(zip(names(features), features, strict=True)):
            found[name] = {
                "shape": shape_record("obstacle", i, obstacle._solid),
                "friction": obstacle.friction,
                "method": obstacle.method,
                "pose": terms[0].contacts[i].obstacle.affine(0.0),
            }
        return {"obstacles": found}


#: A direction of unit length is in the plane if its component out of the plane is at most this.
_FLAT = 1e-9
#: Loads at which a motion is checked to map the plane to itself.
_LOADS = np.linspace(0.0, 1.0, 9)


def _in_plane(kinematics: Kinematics, name: str, obstacle: MovingShape) -> MovingShape:
    """Return an obstacle for a body in two dimensions, whose points have z = 0.

    Boxes get so wide along z that no distance depends on the width. Under axisymmetric torsion the
    shape is revolved about the y axis.

    Raises
    ------
    BadInput
        For a shape or a motion that is not symmetric to the plane; on a body of revolution, for a
        rotation in the half plane; under torsion, for a motion that moves the axis.
    """
    accepted = "a shape and a motion in the plane z = 0"
    shape = _widened(obstacle.shape)
    finite = shape.bounds[:, :2][np.isfinite(shape.bounds[:, :2])]
    reach = float(np.abs(finite).max(initial=1.0))
    probes = np.zeros((64, 3))
    probes[:, :2] = np.random.default_rng(0).uniform(-2 * reach, 2 * reach, (64, 2))
    if np.abs(shape.evaluate(probes).gradient[:, 2]).max() > _FLAT:
        raise bad_value("obstacle", name, accepted)
    for load in _LOADS:
        R, c = obstacle.pose(float(load))
        if kinematics.components == 3:
            if np.abs([*(R[1] - (0, 1, 0)), *R[[0, 2], 1], *c[[0, 2]] / reach]).max() > _FLAT:
                wanted = f"along the axis or about it, with kinematics = '{kinematics.name}'"
                raise bad_value("obstacle", name, f"a motion {wanted}")
            continue
        if np.abs([*R[:2, 2], *R[2, :2], c[2] / reach]).max() > _FLAT:
            raise bad_value("obstacle", name, accepted)
        if kinematics.revolved and np.abs(R - np.eye(3)).max() > _FLAT:
            raise bad_value("obstacle", name, "a translation, on a body of revolution")
    if kinematics.components == 3:
        shape = Revolved(shape)
    return MovingShape(shape, obstacle.motion)


def _widened(shape: Any) -> Any:
    """Return a copy of the shape whose boxes are twice as wide along z as their largest side."""
    if isinstance(shape, Box):
        return replace(shape, size=(*shape.size[:2], 2 * max(shape.size)))
    if hasattr(shape, "shapes"):
        return replace(shape, shapes=tuple(map(_widened, shape.shapes)))
    return shape


def names(obstacles: Sequence[Obstacle]) -> list[str]:
    """Return the obstacles' names, by default obstacle_i. Raises BadInput if two are equal."""
    found = [obstacle.name or f"obstacle_{i}" for i, obstacle in enumerate(obstacles)]
    check_distinct("obstacle.name", found, "obstacle")
    return found
