"""The table ``[[bone]]`` of a scene: solids in the flesh whose nodes follow a motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy.typing as npt
from pydantic import Discriminator, Field, Tag, field_serializer, model_validator

from fem_snh.choices import RESTS
from fem_snh.errors import BadInput, bad_value
from fem_snh.tables.amplitudes import MotionTable
from fem_snh.tables.shapes import ShapeChoice
from fem_snh.tables.types import (
    INT32_MAX,
    FilePath,
    Flag,
    GroupKey,
    NonNegative,
    Positive,
    Seed,
    Steps,
    SurfaceFile,
    Text,
    Vector,
)
from fem_snh.tables.validation import Expect, OneOf, Table, Whole, check_distinct

if TYPE_CHECKING:
    from fem_snh.geometry.bvh import Clip
    from fem_snh.geometry.motions import PoseTable


_MOTION = (
    "the path of a CSV file, a table { bvh, joint }, or a function of the load that returns a 3x4 "
    "matrix"
)
Function = Callable[[float], npt.ArrayLike]


BvhFile = Annotated[FilePath, Expect("the path of a BVH file")]
Frames = Annotated[
    tuple[Annotated[int, Whole(0, INT32_MAX)], Annotated[int, Whole(0, INT32_MAX)]],
    Expect("two whole numbers, the first frame and the last"),
]


class SkeletonMotion(Table):
    """The motion of a joint of a skeleton, from a BVH file.

    Between frames, rotations are slerped. In a scene with ``[time]`` the clip has its own time;
    otherwise its last frame is at load 1.
    """

    bvh: BvhFile = Field(description="The file; its path is relative to the scene file.")
    joint: Text = Field(description="The joint that the bone follows.")
    rest: Annotated[str, OneOf(RESTS)] = Field(
        default=RESTS[0],
        description="The skeleton's pose in the reference configuration: that of the first frame, "
        "or 'offset', all rotations zero and each joint at its OFFSET.",
    )
    frames: Frames | None = Field(
        default=None, description="First and last frame, counted from 0; default: all."
    )
    scale: Positive = Field(
        default=1.0, description="The scene's length of one unit of the file, e.g. 0.01."
    )
    rotation: Vector = Field(
        default=(0.0, 0.0, 0.0),
        description="Rotation of the skeleton, after 'scale': rotation vector about the origin, "
        "axis times angle [rad].",
    )
    translation: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Its displacement, after 'rotation' [length]."
    )

    def motion(self, clip: Clip, duration: float | None) -> tuple[PoseTable, Vector]:
        """Return the bone's motion and the joint's reference position."""
        from fem_snh.geometry.bvh import Placement, joint_motion

        placement = Placement(self.scale, self.rotation, self.translation)
        motion, p = joint_motion(clip, self.joint, self.rest, self.frames, placement, duration)
        return motion, (float(p[0]), float(p[1]), float(p[2]))


class NoiseChoice(Table):
    """Random affine maps that are added to the motions of all bones; zero at load 0.

    They are the same for each run with a seed, whatever the order of the bones.
    """

    amplitude: NonNegative = Field(
        description="Largest displacement of a point of a bone, in parts of the bone's length: "
        "twice the largest distance of its nodes from the centre of their bounding box."
    )
    seed: Seed = Field(default=0, description="Seed of the random numbers.")
    frames: Steps | None = Field(
        default=None,
        description="Number of random maps of each bone, at equal distances from load 0 to 1; "
        "default: one for each of the scene's steps.",
    )
    smooth: Flag = Field(
        default=False,
        description="Whether the disturbance is smooth (a cubic spline) between them; "
        "default: linear.",
    )


class Rig(Table):
    """What concerns all bones."""

    noise: NoiseChoice | None = Field(
        default=None, description="Disturbances of the motions, as production data have them."
    )


def _kind(motion: object) -> str:
    if isinstance(motion, dict | SkeletonMotion):
        return "skeleton"
    return "function" if callable(motion) else "file"


#: What a bone follows; the tags are removed from messages.
BoneMotion = Annotated[
    Annotated[FilePath, Expect(_MOTION), Tag("file")]
    | Annotated[SkeletonMotion, Tag("skeleton")]
    | Annotated[Function, Tag("function")],
    Discriminator(_kind),
]


class BoneChoice(MotionTable):
    """A bone in the flesh: all nodes inside follow its motion.

    It is a shape, a closed surface or a physical group of volumes. Without a motion it does not
    move. Its nodes are those on or below its surface. A node in several bones follows the one in
    which it is deepest; of those in which it is equally deep, the first by name; a group precedes
    all shapes. Bones override ``[[hold]]`` and ``[[move]]``.
    """

    one_of = ("shape", "surface", "group")
    excludes = {"motion": ("translate", "rotate", "table")}
    name: Text = Field(description="Its name in results and in the files of motions.")
    shape: ShapeChoice | None = Field(
        default=None, description="Its shape; or 'surface' or 'group'."
    )
    surface: SurfaceFile | None = Field(
        default=None,
        description="STL or OBJ file of a closed surface, instead of 'shape'; "
        "its path is relative to the scene file.",
    )
    group: GroupKey | None = Field(
        default=None,
        description="Physical group of volumes, by name or number, instead of 'shape'.",
    )
    motion: BoneMotion | None = Field(
        default=None,
        description="Affine maps, instead of 'translate' and 'rotate': a CSV file, relative to the "
        "scene file, with the columns load or time, bone, a11, a12, ..., a34; a joint of a "
        "skeleton; or, in Python, a function of the load that returns a 3x4 matrix.",
    )
    rigid: Flag = Field(
        default=False,
        description="Whether the maps of 'motion' are rigid: rotations between two rows are then "
        "slerped, otherwise each entry is linear.",
    )
    origin: Vector | None = Field(
        default=None,
        description="Reference point about which its moment is given [length]; "
        "default: its joint, or the centre of the bounding box of its nodes.",
    )

    @model_validator(mode="after")
    def _check_rigid(self) -> BoneChoice:
        if self.rigid and not isinstance(self.motion, Path):
            raise bad_value("rigid", True, "no value without the CSV file of a 'motion'")
        return self

    @field_serializer("motion", when_used="json-unless-none")
    def _motion_record(self, motion: Any) -> Any:
        """Return a function by its name: its code cannot be compared."""
        if isinstance(motion, SkeletonMotion):
            return motion.model_dump(mode="json")
        if callable(motion):
            return f"function {getattr(motion, '__qualname__', type(motion).__name__)}"
        return str(motion)


def check_bones(choices: Sequence[BoneChoice], rig: Rig | None, obstacles: Sequence[str]) -> None:
    """Raise BadInput if two bones or obstacles have the same name, or for a rig without bones."""
    names = [choice.name for choice in choices]
    check_distinct("bone.name", [*names, *obstacles], "bone and obstacle")
    if rig is not None and not choices:
        raise BadInput("'rig': expected with a table [[bone]], which the scene does not have")
