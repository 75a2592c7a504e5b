"""The scene's tables of parts of a body that move as rigid bodies, and of their joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from fem_snh.arrays import Array
from fem_snh.errors import BadInput, bad_value, choose
from fem_snh.geometry.shapes import Shape
from fem_snh.tables.amplitudes import TABLE, MotionTable, TableName
from fem_snh.tables.shapes import ShapeChoice, shape_of, shape_record
from fem_snh.tables.types import (
    NonNegative,
    Number,
    Part,
    SurfaceFile,
    Text,
    Vector,
    split_text,
    surface_name,
)
from fem_snh.tables.validation import Expect, OneOf, Table, check_distinct
from fem_snh.terms.feature import Feature

if TYPE_CHECKING:
    from fem_snh.assembly.kinematics import Kinematics
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term

#: The motions of a part that may be free while others are prescribed.
MOTIONS = ("x", "y", "z", "rotation")
#: The kinds of joints.
KINDS = ("ball", "hinge", "slider")
#: The results of a part that may be goals of an error estimate, in their order in a scene.
RESULTS = ("displacement", "rotation", "force", "moment")
#: The kinds of joints with an axis.
_WITH_AXIS = KINDS[1:]


class RigidJoint(Table):
    """A joint of a rigid part to the world or to another rigid part."""

    kind: Annotated[str, OneOf(KINDS)] = Field(
        description="ball: a rotation about a point is free; hinge: one about an axis; slider: a "
        "translation along an axis, without rotation."
    )
    through: Vector = Field(
        description="Reference coordinates of the point, or of one of the axis [length]."
    )
    axis: Vector | None = Field(
        default=None, description="Direction of a hinge's or a slider's axis; none of a ball joint."
    )
    to: Text | None = Field(
        default=None,
        description="Name of the rigid part that the joint connects this one to, and that carries "
        "point and axis; default: the world.",
    )
    torque: Number = Field(
        default=0.0,
        description="Moment of a hinge about its axis at the part's load amplitude [N m]: on this "
        "part and, in the opposite sense, on the one that it is joined to.",
    )
    force: Number = Field(
        default=0.0, description="Force of a slider along its axis, on both parts likewise [N]."
    )

    @model_validator(mode="after")
    def _check_axis(self) -> RigidJoint:
        if (self.axis is None) == (self.kind in _WITH_AXIS):
            needed = "a direction" if self.axis is None else "no value"
            raise BadInput(f"axis: expected {needed}, of a {self.kind} joint")
        if self.axis is not None and not any(self.axis):
            raise bad_value("axis", list(self.axis), "a vector that is not zero")
        for key, kind in (("torque", "hinge"), ("force", "slider")):
            if getattr(self, key) and self.kind != kind:
                raise bad_value(key, getattr(self, key), f"no value, but for a {kind}")
        return self


class RigidSpring(Table):
    """Springs of a rigid part, stress-free in the reference configuration."""

    stiffness: NonNegative = Field(
        default=0.0, description="Force per displacement of the point ``about`` [N/m]."
    )
    rotation: NonNegative = Field(
        default=0.0,
        description="Moment per angle of the rotation relative to the part that a joint connects "
        "to, or to the world, less than half a turn [N m].",
    )


class Rigid(Feature, MotionTable):
    r"""A group of cells or facets, or the nodes in a shape, that moves as a rigid body.

    It has six unknowns, in a plane three. In a body of revolution they are the translation along
    the axis and, with torsion, the rotation about the axis.

    .. math:: x = c + R (X - p), \qquad p \text{ the point } \mathtt{about}

    All motions are free, unless ``translate``, ``rotate`` or ``free`` is given. The motions that
    ``free`` does not name are then prescribed, as by [[move]], or zero.
    """

    key, planar, releases = "rigid", True, True
    one_of = ("group", "shape", "surface")
    excludes = {"joint": ("translate", "rotate", "free", "about")}
    needs = {
        **MotionTable.needs,
        "load_table": ("force", "torque", "joint.torque", "joint.force"),
        "follower": ("force", "torque"),
    }
    group: Part | None = Field(
        default=None,
        description="Physical group of volumes or surfaces, by name or number; in a program a "
        "measure dx(...) or ds(...); or 'shape', or 'surface'.",
    )
    shape: ShapeChoice | None = Field(
        default=None,
        description="Shape, instead of 'group', with a 'name': all nodes on or below its surface.",
    )
    surface: SurfaceFile | None = Field(
        default=None,
        description="STL or OBJ file of a closed surface, instead of 'group', with a 'name'; its "
        "path is relative to the scene file.",
    )
    name: Text | None = Field(default=None, description="Name in the results; default: the group.")
    about: Vector | None = Field(
        default=None,
        description="Reference coordinates of the point at which forces act and to which moments "
        "and displacements refer [length]; default: a joint's point, the group's centroid, or the "
        "middle of the shape's bounding box.",
    )
    free: (
        Annotated[
            tuple[Literal["x", "y", "z", "rotation"], ...],
            Expect("a list of 'x', 'y', 'z' (of the point), 'rotation'"),
            BeforeValidator(split_text),
        ]
        | None
    ) = Field(
        default=None,
        description="Components of the point's displacement, or the rotation, that are free where "
        "the others are prescribed.",
    )
    joint: RigidJoint | None = Field(default=None, description="What connects the part.")
    force: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Force of constant direction at amplitude 1 [N]."
    )
    torque: Vector = Field(
        default=(0.0, 0.0, 0.0),
        description="Moment at amplitude 1 [N m], of constant direction unless it follows.",
    )
    follower: bool = Field(
        default=False, description="Whether force and torque turn with the part."
    )
    load_table: TableName | None = Field(default=None, description=TABLE)
    mass: NonNegative = Field(
        default=0.0,
        description="With [time]: mass [kg] of a part of surfaces, uniform over them, beside that "
        "of the cells.",
    )
    spring: RigidSpring | None = Field(default=None, description="Springs that hold the part.")

    @model_validator(mode="after")
    def _check_nodes(self) -> Rigid:
        if self.given_key != "group" and self.name is None:
            raise BadInput(f"missing key 'name': expected with '{self.given_key}'")
        return self

    @model_validator(mode="after")
    def _check_motion(self) -> Rigid:
        moved = (*(self.translate or (0, 0, 0)), self.rotate)
        motions = dict(zip(MOTIONS, moved, strict=True))
        for motion in self.free or ():
            if motions[motion]:
                accepted = "motions that 'translate' and 'rotate' do not prescribe"
                raise bad_value("free", motion, accepted)
        return self

    @model_validator(mode="after")
    def _check_effects(self) -> Rigid:
        """Raise BadInput for a load or a spring along motions that the part does not have."""
        translations, rotations = self._directions()
        spring = self.spring or RigidSpring()
        moves, turns = len(translations) or self.translate, len(rotations) or self.rotate
        for key, value, acts, motion in (
            ("force", self.force, np.any(translations @ self.force), "move"),
            ("torque", self.torque, np.any(rotations @ self.torque), "turn"),
            ("spring.stiffness", spring.stiffness, moves, "move"),
            ("spring.rotation", spring.rotation, turns, "turn"),
        ):
            if np.any(value) and not acts:
                given = list(value) if isinstance(value, tuple) else value
                accepted = f"no value, as nothing lets the part {motion} so"
                raise bad_value(key, given, accepted)
        return self

    def _directions(self) -> tuple[Array, Array]:
        """Return the directions (n, 3) in which the part may move, and about which it may turn.

        A part with a joint to another part has all directions: the joint carries forces to it.
        """
        every, none = np.eye(3), np.zeros((0, 3))
        if joint := self.joint:
            axis = np.reshape(joint.axis or (), (-1, 3))
            free = {"ball": (none, every), "hinge": (none, axis), "slider": (axis, none)}
            return free[joint.kind] if joint.to is None else (every, every)
        *translations, rotation = self.free_motions
        moves = every if self.follower and any(translations) else every[translations]
        return moves, every if rotation else none

    @property
    def label(self) -> str:
        """The part's name in results."""
        return self.name or surface_name(self.group)

    @property
    def free_motions(self) -> tuple[bool, bool, bool, bool]:
        """Whether x, y, z and the rotation are free, in the order of MOTIONS; ignores a joint."""
        if not self.is_moved and self.free is None:
            return (True,) * 4
        x, y, z, rotation = (motion in (self.free or ()) for motion in MOTIONS)
        return x, y, z, rotation

    @property
    def unknown_results(self) -> list[str]:
        """The results that are unknown: two of `RESULTS`.

        They are "displacement" if a translation is free, else "force"; and "rotation" if the
        rotation is free, else "moment".
        """
        *translations, rotation = self.free_motions
        moves, turns = any(translations), rotation
        if self.joint:
            moves, turns = self.joint.kind == "slider", self.joint.kind != "slider"
        return ["displacement" if moves else "force", "rotation" if turns else "moment"]

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput for a part with the name of an obstacle, and as `check_names` does."""
        obstacles = [obstacle.name for obstacle in scene.obstacle]
        for part in features:
            if part.label in obstacles:
                raise bad_value("rigid.name", part.label, "a name that no obstacle has")
        check_names(features)

    @property
    def where(self) -> str:
        """The key that selects the part's nodes, as "rigid.group", for messages."""
        return f"rigid.{self.given_key}"

    def solid(self) -> Shape | None:
        """Return the part's shape, or None for a group. May read a file and raise BadInput."""
        choice = self.shape or self.surface
        return shape_of(choice) if choice else None

    @classmethod
    def describe(cls, features: Sequence[Self], terms: Sequence[Any]) -> Mapping[str, Any]:
        """Return {"rigid": rows by name} for run.json; only parts given by a shape have a row.

        A row has the ``shape``, a table of one key as in the scene (for a surface, the name of its
        file in the run's folder), and the reference coordinates of the part's ``point``.
        """
        found = {}
        for i, part in enumerate(features):
            if choice := part.shape or part.surface:
                shape, point = shape_record("rigid", i, choice), terms[0].place(part.label)
                found[part.label] = {"shape": shape, "point": point.tolist()}
        return {"rigid": found} if found else {}

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return one term of all parts. Collective."""
        from fem_snh.terms.rigid_parts import RigidParts  # imports PETSc

        check_names(features)
        return [RigidParts(features, body)]


def check_motions(part: Rigid, kinematics: Kinematics) -> None:
    """Raise BadInput for a key of a part that names motions which the kinematics lacks."""
    along, about = np.reshape(kinematics.rigid_motions, (2, 3))
    if about.all():
        return
    joint, rotate, turns = part.joint, part.rotate, about.any()
    accepted = f"motions along {' and '.join(np.array(list('xyz'))[along])} alone"
    for axis in np.array(list("xyz"))[about]:
        accepted += f", and about {axis}"
    accepted += f", with kinematics = '{kinematics.name}'"
    slides = joint is not None and joint.kind == "slider"
    vectors = {
        "translate": (part.translate, along),
        "force": (part.force, along),
        "torque": (part.torque, about),
        "rotate.axis": (rotate and rotate.axis, about),
        "joint.axis": (joint and joint.axis, along if slides else about),
        "about": (part.about, along),
        "rotate.through": (rotate and rotate.through, along),
        "joint.through": (joint and joint.through, along),
    }
    for key, (vector, components) in vectors.items():
        if np.any(np.array(vector or np.zeros(3))[~components]):
            raise bad_value(f"rigid.{key}", list(vector or ()), accepted)
    there = dict(zip(MOTIONS, (*along, turns), strict=True))
    for motion in part.free or ():
        if not there[motion]:
            raise bad_value("rigid.free", motion, accepted)
    if not turns and part.spring and part.spring.rotation:
        raise bad_value("rigid.spring.rotation", part.spring.rotation, accepted)
    if not turns and joint and not slides:
        raise bad_value("rigid.joint.kind", joint.kind, accepted)


def check_names(parts: Sequence[Rigid]) -> None:
    """Raise BadInput if two parts have one name, or a joint connects to no part or in a loop."""
    names = [part.label for part in parts]
    check_distinct("rigid.name", names, "part")
    parents = {part.label: part.joint.to for part in parts if part.joint and part.joint.to}
    for name, parent in parents.items():
        choose("rigid.joint.to", parent, [other for other in names if other != name])
        chain = [name]
        while chain[-1] in parents:
            chain.append(parents[chain[-1]])
            if chain[-1] == name:
                accepted = "joints that connect no part to itself: " + " to ".join(chain)
                raise bad_value("rigid.joint.to", parent, accepted)
