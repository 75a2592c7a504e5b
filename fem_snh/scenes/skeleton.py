"""Skeletons: joints that turn bones, and the bones' affine motions by forward kinematics.

The built-in scenes ``hand`` and ``torso`` move their bones by them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from fem_snh.errors import bad_value, choose
from fem_snh.geometry.bvh import global_pose

Array = npt.NDArray[np.float64]
Point = tuple[float, float, float]
#: Keys of scenes of flesh on bones. The initial guess of a step moves the flesh with its bones
#: (a coarse hand: 9.4 Newton iterations a step instead of 10.6). ``snes_atol`` is the bound of
#: Smith et al. 2018 on the residual's norm (section 6, no units) [N].
SOLUTION: dict[str, Any] = {"predictor": "bones", "petsc": {"snes_atol": 1e-2}}
#: No point of a cube of edge 1 is farther from its nearest corner.
_HALF_DIAGONAL = 3**0.5 / 2


@dataclass(frozen=True)
class BallJoint:
    """A ball joint, which turns all bones and joints that hang on it.

    Attributes
    ----------
    name : str
        Its name.
    parent : str or None
        The joint on which it hangs; None: it hangs on nothing that moves.
    position : (3,) tuple
        Its reference position [length].
    rotation : (3,) tuple
        Rotation vector at the end, relative to the parent, in the axes of the reference
        configuration: the axis, times the angle [rad].
    begin, end : float
        The loads between which it turns; the angle is linear in the load.
    """

    name: str
    parent: str | None
    position: Point
    rotation: Point = (0.0, 0.0, 0.0)
    begin: float = 0.0
    end: float = 1.0


@dataclass(frozen=True)
class BoneSegment:
    """A bone: the points within a radius of a segment, and the joint that moves it.

    Attributes
    ----------
    name, joint : str
        Its name, and that of its joint.
    start, end : (3,) tuple
        The ends of the segment [length].
    radius : float
        The radius [length].
    """

    name: str
    joint: str
    start: Point
    end: Point
    radius: float


@dataclass(frozen=True)
class Skeleton:
    r"""Joints that form a tree, and their motions.

    A joint at :math:`p` whose parent moves by the affine map :math:`A_p` moves by

    .. math:: A(x) = A_p(p + R (x - p)),

    where :math:`R` is its own rotation. At load 0 every map is the identity.

    Attributes
    ----------
    joints : sequence of BallJoint
        Each after its parent.

    Raises
    ------
    BadInput
        For a joint that comes before its parent, and for two of the same name.
    """

    joints: Sequence[BallJoint]
    _numbers: Mapping[str, int] = field(init=False, repr=False, compare=False)
    _parents: Sequence[int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        numbers: dict[str, int] = {}
        parents = []
        for joint in self.joints:
            if joint.name in numbers:
                raise bad_value("joint", joint.name, "a different name for each joint")
            on = joint.parent
            parents.append(-1 if on is None else numbers[choose("parent", on, tuple(numbers))])
            numbers[joint.name] = len(numbers)
        object.__setattr__(self, "_numbers", numbers)
        object.__setattr__(self, "_parents", parents)

    def affine(self, name: str, load: float) -> Array:
        """Return the affine map (3, 4) of a joint at a load: reference to present positions."""

        def turned(number: int) -> tuple[Array, Array]:
            """Return the joint's own rotation about its reference position."""
            joint = self.joints[number]
            part = np.clip((load - joint.begin) / (joint.end - joint.begin), 0.0, 1.0)
            R = Rotation.from_rotvec(part * np.asarray(joint.rotation)).as_matrix()
            p = np.asarray(joint.position)
            return R[None], (p - R @ p)[None]

        R, d = global_pose(self._numbers[name], self._parents, turned)
        return np.column_stack([R[0], d[0]])

    def motion(self, name: str) -> JointMotion:
        """Return the motion of a joint.

        Raises
        ------
        BadInput
            For an unknown joint.
        """
        return JointMotion(self, choose("joint", name, tuple(self._numbers)))

    def tables(self, bones: Sequence[BoneSegment], cell: float) -> list[dict[str, Any]]:
        """Return bones as tables of a scene: capsules with the motions of their joints.

        In a lattice of cells with edges ``cell`` [length], every bone has a node: one that is too
        thin gets the radius that makes it sure.
        """
        return [
            {
                "name": bone.name,
                "shape": capsule(bone.start, bone.end, max(bone.radius, _HALF_DIAGONAL * cell)),
                "motion": self.motion(bone.joint),
            }
            for bone in bones
        ]


class JointMotion:  # no dataclass: pydantic would write it as a table
    """The motion of a joint: its affine map (3, 4) as a function of the load."""

    def __init__(self, skeleton: Skeleton, joint: str) -> None:
        self._skeleton, self._joint = skeleton, joint

    def __call__(self, load: float) -> Array:
        """Return the affine map (3, 4) at a load."""
        return self._skeleton.affine(self._joint, load)


def limb(
    parent: BallJoint,
    names: Sequence[str],
    points: Sequence[Sequence[float]],
    directions: Sequence[Sequence[float]],
    begin: float = 0.0,
    end: float = 1.0,
) -> list[BallJoint]:
    """Return joints in a row, each on the one before, that turn straight segments.

    Parameters
    ----------
    parent : BallJoint
        The joint on which the first one hangs; it stands still.
    names : sequence of str
        Names of the n joints.
    points : (n + 1, 3) sequence
        Reference positions of the joints and of the tip of the last segment [length].
    directions : (n, 3) sequence
        The directions of the segments at the end. Each joint turns by the smallest angle that
        leads there.
    begin, end : float
        The loads between which they turn.
    """
    joints: list[BallJoint] = []
    turned = Rotation.identity()  # of the segment before
    for k, name in enumerate(names):
        segment = np.subtract(points[k + 1], points[k])
        rotation = _smallest_rotation(segment, turned.inv().apply(directions[k]))
        on = joints[-1].name if joints else parent.name
        joints.append(
            BallJoint(name, on, point(points[k]), point(rotation.as_rotvec()), begin, end)
        )
        turned = turned * rotation
    return joints


def bone_between(
    name: str, joint: str, start: Sequence[float], end: Sequence[float], radius: float, gap: float
) -> BoneSegment:
    """Return a bone between two joints, whose segment ends ``gap`` before each [length]."""
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    inset = gap * (b - a) / np.linalg.norm(b - a)
    return BoneSegment(name, joint, point(a + inset), point(b - inset), radius)


def capsule(start: Sequence[float], end: Sequence[float], radius: float) -> dict[str, Any]:
    """Return the table of a capsule: the points within a radius of a segment [length]."""
    return {"capsule": {"from": point(start), "to": point(end), "radius": float(radius)}}


def point(x: Any) -> Point:
    """Return three numbers as a tuple of Python's floats, which a scene's tables accept."""
    a, b, c = (float(value) for value in x)
    return a, b, c


def _smallest_rotation(a: Array, b: Array) -> Rotation:
    """Return the rotation by the smallest angle from the direction of a to that of b."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, a @ b)
    return Rotation.from_rotvec(axis * (angle / sine if sine > 0 else 0.0))
