"""The table ``[[bone]]`` of a scene: solids in the flesh whose nodes follow a motion.

The built-in scenes ``hand`` and ``torso`` move their bones by the joints of a limb.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from pydantic import Discriminator, Field, PlainSerializer, Tag, model_validator

from fem_snh.arrays import Array, ArrayLike
from fem_snh.errors import bad_value
from fem_snh.geometry.motion_files import bone_motion, read_rows
from fem_snh.geometry.motions import Bone, DisplacementMotion, Motion, Noise
from fem_snh.geometry.rotations import exponential
from fem_snh.tables.amplitudes import MotionTable, function_name
from fem_snh.tables.shapes import ShapeChoice, shape_of
from fem_snh.tables.types import (
    FilePath,
    Flag,
    GroupKey,
    NonNegative,
    Seed,
    Steps,
    SurfaceFile,
    Text,
    Vector,
)
from fem_snh.tables.validation import Expect, Table

if TYPE_CHECKING:
    from fem_snh.scenes.schema import Scene

_MOTION = "the path of a CSV file, or a function of the load that returns a 3x4 matrix"
Function = Callable[[float], ArrayLike]


class NoiseChoice(Table):
    """Random affine maps that are added to the motions of all bones; zero at load 0.

    A seed gives the same maps in each run, whatever the order of the bones.
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


class Rig(Table):
    """Settings of all bones."""

    noise: NoiseChoice | None = Field(
        default=None, description="Disturbances of the motions, as production data have them."
    )


def _kind(motion: object) -> str:
    return "<function>" if callable(motion) else "<file>"


#: What a bone follows; the tags are removed from messages.
BoneMotion = Annotated[
    Annotated[FilePath, Expect(_MOTION), Tag("<file>")]
    | Annotated[Function, Tag("<function>"), PlainSerializer(function_name, when_used="json")],
    Discriminator(_kind),
]


class BoneChoice(MotionTable):
    """A bone in the flesh: all nodes inside follow its motion.

    The bone is a shape, a closed surface or a physical group of volumes. Without a motion it does
    not move. Its nodes are those on or below its surface. A node in several bones follows a group
    rather than a shape, then the bone in which it is deepest, then the first by name. Bones
    override ``[[hold]]`` and ``[[move]]``.
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
        "scene file, with the columns load or time, bone, a11, a12, ..., a34; "
        "or, in Python, a function of the load that returns a 3x4 matrix.",
    )
    rigid: Flag = Field(
        default=False,
        description="Whether the maps of 'motion' are rigid: rotations between two rows are then "
        "slerped, otherwise each entry is linear.",
    )
    origin: Vector | None = Field(
        default=None,
        description="Reference point about which its moment is given [length]; "
        "default: the centre of the bounding box of its nodes.",
    )

    @model_validator(mode="after")
    def _check_rigid(self) -> BoneChoice:
        if self.rigid and not isinstance(self.motion, Path):
            raise bad_value("rigid", True, "no value without the CSV file of a 'motion'")
        return self


def read_bones(scene: Scene) -> list[Bone]:
    """Return the bones of a scene with their motions; each file of motions is read once.

    Raises
    ------
    BadInput
        One line, for a file that cannot be read or is not valid, a bone that is not in its file,
        and a name in a file that no bone has.
    """
    names = [choice.name for choice in scene.bone]
    rows = cache(partial(read_rows, bones=names))
    noise = None
    if scene.rig and (chosen := scene.rig.noise):
        steps = scene.time.steps if scene.time else scene.steps
        noise = Noise(chosen.amplitude, chosen.seed, chosen.frames or steps)
    bones = []
    for choice in scene.bone:
        solid = choice.shape or choice.surface
        shape = shape_of(solid) if solid else None
        motion: Motion | Function | None = None
        if isinstance(choice.motion, Path):
            keys = choice.name, scene.duration, choice.rigid
            motion = bone_motion(choice.motion, rows(choice.motion), *keys)
        elif choice.is_moved:
            motion = DisplacementMotion(choice.scaled(scene.amplitudes).displacement)
        else:
            motion = choice.motion
        bones.append(Bone(choice.name, shape, choice.group, motion, choice.origin, noise))
    return bones


# --- skeletons of built-in scenes ----------------------------------------------------------------

#: No point of a cube of edge 1 is farther from its nearest corner.
_HALF_DIAGONAL = 3**0.5 / 2


class JointMotion:  # no dataclass: pydantic would write it as a table
    r"""The motion of a ball joint, which turns all bones and joints that hang on it.

    A joint at :math:`p` whose parent moves by the affine map :math:`A_p` moves by

    .. math:: A(x) = A_p(p + R (x - p)),

    where :math:`R` is its own rotation. At load 0 every map is the identity.

    Parameters
    ----------
    position : (3,) sequence
        Reference position of the joint [length].
    rotation : (3,) sequence
        Rotation vector at the end, relative to the parent, in the axes of the reference
        configuration: the axis, times the angle [rad].
    parent : JointMotion, optional
        The joint on which this one hangs; without a parent the position is fixed.
    begin, end : float
        The loads between which the joint turns; the angle is linear in the load.
    """

    def __init__(
        self,
        position: ArrayLike,
        rotation: ArrayLike = (0.0, 0.0, 0.0),
        parent: JointMotion | None = None,
        begin: float = 0.0,
        end: float = 1.0,
    ) -> None:
        self.position, self.rotation = np.asarray(position), np.asarray(rotation)
        self.parent = parent
        self.begin, self.end = begin, end

    def __call__(self, load: float) -> Array:
        """Return the affine map (3, 4) at a load: reference to present positions."""
        part = np.clip((load - self.begin) / (self.end - self.begin), 0.0, 1.0)
        R = exponential(part * self.rotation)
        d = self.position - R @ self.position
        if self.parent is not None:
            outer = self.parent(load)
            R, d = outer[:, :3] @ R, outer[:, :3] @ d + outer[:, 3]
        return np.column_stack([R, d])


class BoneSegment(NamedTuple):
    """A bone: the points within a radius of a segment [length], and the joint that moves it."""

    name: str
    joint: JointMotion
    start: ArrayLike
    end: ArrayLike
    radius: float

    def table(self, cell: float) -> dict[str, Any]:
        """Return the bone as a table of a scene: a capsule with the motion of its joint.

        In a lattice of cells with edges ``cell`` [length], the radius is at least half a cell's
        diagonal, so that a node of the lattice is inside.
        """
        radius = max(self.radius, _HALF_DIAGONAL * cell)
        shape = capsule(self.start, self.end, radius)
        return {"name": self.name, "shape": shape, "motion": self.joint}


def limb(
    parent: JointMotion,
    names: Sequence[str],
    points: Array,
    directions: ArrayLike,
    sections: Iterable[tuple[float, float]],
    begin: float = 0.0,
    end: float = 1.0,
) -> list[BoneSegment]:
    """Return a chain of bones, each with a joint that hangs on the previous joint.

    Parameters
    ----------
    parent : JointMotion
        The joint on which the first bone's joint hangs; it must not move.
    names : sequence of str
        The names of the n bones.
    points : (n + 1, 3) array
        Reference positions of the joints and of the tip of the last bone [length].
    directions : (n, 3) array
        The directions of the bones at load ``end``. Each joint turns by the smallest angle.
    sections : iterable of (float, float)
        The radius of each bone, and how far before the joints its axis ends [length].
    begin, end : float
        The loads between which the joints turn.
    """
    bones: list[BoneSegment] = []
    joint, turned = parent, np.eye(3)  # of the bone before
    rows = zip(names, points[:-1], points[1:], np.asarray(directions), sections, strict=True)
    for name, start, tip, direction, (radius, gap) in rows:
        segment, wanted = np.subtract(tip, start), turned.T @ direction
        axis = np.cross(segment, wanted)
        sine = float(np.linalg.norm(axis))
        rotation = axis * (np.arctan2(sine, segment @ wanted) / sine if sine > 0 else 0.0)
        joint = JointMotion(start, rotation, joint, begin, end)
        bones.append(bone_between(name, joint, start, tip, radius, gap))
        turned = turned @ exponential(rotation)
    return bones


def bone_between(
    name: str, joint: JointMotion, start: Array, end: Array, radius: float, gap: float
) -> BoneSegment:
    """Return a bone between two joints, whose segment ends ``gap`` before each [length]."""
    inset = gap * (end - start) / np.linalg.norm(end - start)
    return BoneSegment(name, joint, start + inset, end - inset, radius)


def capsule(start: ArrayLike, end: ArrayLike, radius: float) -> dict[str, Any]:
    """Return the table of a capsule: the points within a radius of a segment [length]."""
    return {"capsule": {"from": start, "to": end, "radius": radius}}


def lattice_scene(
    shape: dict[str, Any],
    cell: float,
    bones: Sequence[BoneSegment],
    noise: float,
    seed: int,
    contact: bool,
    **keys: Any,
) -> dict[str, Any]:
    """Return the tables of a scene of flesh in a lattice with bones inside, and further ``keys``.

    The initial guess of a step moves the flesh with its bones (a coarse hand: 9.4 Newton iterations
    a step instead of 10.6). ``snes_atol`` is the bound of Smith et al. 2018 on the residual's norm
    (section 6, no units) [N].

    Parameters
    ----------
    shape : mapping
        The table of the body's shape.
    cell : float
        Edge of a cell [m].
    bones : sequence of BoneSegment
        The bones.
    noise : float
        Noise of the bones' affine maps, relative to the length of the bone.
    seed : int
        Seed of the noise.
    contact : bool
        Whether the surface has self-contact.
    """
    tables: dict[str, Any] = {
        "mesh": {"lattice": shape, "cell": cell, "weighting": "full"},
        "material": {"name": "stable_neo_hookean", "E": 5e4, "nu": 0.488},
        "bone": [bone.table(cell) for bone in bones],
        "predictor": "bones",
        "petsc": {"snes_atol": 1e-2} | keys.pop("petsc", {}),
    }
    if contact:
        tables["self_contact"] = {"method": "reference"}
    if noise:
        tables["rig"] = {"noise": {"amplitude": noise, "seed": seed}}
    return tables | keys
