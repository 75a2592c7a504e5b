"""Skeletons: BVH files (Biovision hierarchy), and motions of bones that follow their joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fem_snh.choices import RESTS
from fem_snh.errors import BadInput, bad_value, shown
from fem_snh.geometry.motion_files import finite_number, read_motion_text
from fem_snh.geometry.motions import PoseTable
from fem_snh.geometry.rotations import exponential
from fem_snh.geometry.shapes.shape import Array

#: The first letters of channels.
AXES = "XYZ"
_CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in AXES)
#: How far a clip may miss the end of the run, in frames: files round the time of a frame.
_ROUNDED = 0.5


@dataclass(frozen=True)
class Joint:
    """A joint of a skeleton.

    Attributes
    ----------
    name : str
        Its name.
    parent : int
        The number of its parent; -1 of a root.
    offset : (3,) array
        Its position in the frame of its parent.
    channels : tuple of str
        Its channels, such as "Xposition" and "Zrotation", in the file's order.
    first : int
        The column of its first channel.
    """

    name: str
    parent: int
    offset: Array
    channels: tuple[str, ...]
    first: int


class Clip(NamedTuple):
    """A skeleton with its motion.

    Attributes
    ----------
    path : Path
        The file.
    joints : list of Joint
        The joints; parents precede their children.
    frame_time : float
        The time between two frames [s].
    frames : (frames, channels) array
        Values of all channels: the file's unit of length, and degrees.
    """

    path: Path
    joints: list[Joint]
    frame_time: float
    frames: Array


class _Words:
    """The words of a file with the numbers of their lines."""

    def __init__(self, path: Path, text: str) -> None:
        self._path, self._line = path, 0
        self._words = self._split(text)

    def _split(self, text: str) -> Iterator[str]:
        for self._line, line in enumerate(text.splitlines(), 1):
            yield from line.split()

    def next(self) -> str:
        """Return the next word; an empty one at the end of the file."""
        return next(self._words, "")

    def error(self, found: str, expected: str) -> BadInput:
        """Return the exception for a word that is not the expected one."""
        word = shown(found) if found else "the end of the file"
        return BadInput(f"{self._path}, line {self._line}: {word}: expected {expected}")

    def expect(self, *words: str) -> str:
        """Return the next word, which must be one of these."""
        found = self.next()
        if found not in words:
            raise self.error(found, " or ".join(f"'{word}'" for word in words))
        return found

    def number(self) -> float:
        """Return the next word as a finite number."""
        found = self.next()
        if not found:
            raise self.error(found, "a finite number")
        return finite_number(f"{self._path}, line {self._line}: ", found)

    def count(self) -> int:
        """Return the next word as a whole number."""
        value = self.number()
        if value != int(value) or value < 0:
            raise self.error(f"{value:g}", "a whole number >= 0")
        return int(value)

    def vector(self) -> Array:
        """Return the next three words as numbers, (3,)."""
        return np.array([self.number() for _ in range(3)])


def read_bvh(path: str | Path) -> Clip:
    """Read a BVH file.

    Raises
    ------
    BadInput
        One line, for a file that cannot be read or is no BVH file, or with fewer than two frames.
    """
    path = Path(path)
    text = read_motion_text(path, "motion.bvh", "BVH")
    words, joints = _Words(path, text), list[Joint]()
    words.expect("HIERARCHY")
    while words.expect("ROOT", "MOTION") == "ROOT":
        _read_joints(words, joints)
    width = sum(len(joint.channels) for joint in joints)
    words.expect("Frames:")
    count = words.count()
    words.expect("Frame")
    words.expect("Time:")
    frame_time = words.number()
    if count < 2 or not frame_time > 0 or not width:
        raise BadInput(f"motion.bvh = '{path}': expected joints, two frames or more and a time > 0")
    frames = np.array([[words.number() for _ in range(width)] for _ in range(count)])
    if extra := words.next():
        raise words.error(extra, f"the end of the file after {count} frames of {width} numbers")
    return Clip(path, joints, frame_time, frames)


def _read_joints(words: _Words, joints: list[Joint]) -> None:
    """Append a root and all joints below it; its first word, ROOT, has been read."""
    parents = [_read_joint(words, joints, -1)]
    while parents:
        match words.expect("JOINT", "End", "}"):
            case "JOINT":
                parents.append(_read_joint(words, joints, parents[-1]))
            case "End":
                for word in ("Site", "{", "OFFSET"):
                    words.expect(word)
                words.vector()
                words.expect("}")
            case _:
                parents.pop()


def _read_joint(words: _Words, joints: list[Joint], parent: int) -> int:
    """Append a joint without its children; return its number. Its first word has been read."""
    name = [words.next()]
    while (word := words.next()) != "{":  # a name may have spaces
        if not word:
            raise words.error(word, "'{'")
        name.append(word)
    joined = " ".join(name)
    if any(joint.name == joined for joint in joints):
        raise words.error(joined, "a name that no other joint has")
    words.expect("OFFSET")
    offset = words.vector()
    words.expect("CHANNELS")
    channels = tuple(words.expect(*_CHANNELS) for _ in range(words.count()))
    first = joints[-1].first + len(joints[-1].channels) if joints else 0
    joints.append(Joint(joined, parent, offset, channels, first))
    return len(joints) - 1


@dataclass(frozen=True)
class Placement:
    """Where a skeleton is in the scene: x = R s x_file + d.

    Attributes
    ----------
    scale : float
        The scene's unit of length over the file's, s.
    rotation : (3,) tuple
        Rotation vector of R: axis times angle [rad].
    translation : (3,) tuple
        d [length].
    """

    scale: float = 1.0
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)


def joint_motion(
    clip: Clip,
    joint: str,
    rest: str = RESTS[0],
    frames: tuple[int, int] | None = None,
    placement: Placement | None = None,
    duration: float | None = None,
) -> tuple[PoseTable, Array]:
    """Return the motion of a bone that follows a joint, and the joint's reference position.

    Parameters
    ----------
    clip : Clip
        The skeleton with its motion.
    joint : str
        The joint.
    rest : {"first", "offset"}
        The skeleton's pose in the reference configuration: that of the first frame, or without
        rotations, each joint at its offset.
    frames : (int, int), optional
        The first and the last frame, counted from 0; default: all.
    placement : Placement, optional
        Where the skeleton is in the scene.
    duration : float, optional
        The length of the run [s], with the clip's own time; without it the last frame is at load 1.

    Returns
    -------
    PoseTable
        Between frames rotations are slerped and positions of the joint linear.
    (3,) array
        The joint in the reference configuration [length].

    Raises
    ------
    BadInput
        For an unknown joint, frames that the clip does not have, and a clip that ends too early.
    """
    names = [j.name for j in clip.joints]
    if joint not in names:
        accepted = f"a joint of {clip.path}: {', '.join(names)}"
        raise bad_value("motion.joint", joint, accepted, names)
    first, last = frames or (0, len(clip.frames) - 1)
    if not 0 <= first < last < len(clip.frames):
        accepted = f"two ascending numbers from 0 to {len(clip.frames) - 1}, as {clip.path} has"
        raise bad_value("motion.frames", list(frames or ()), accepted)
    chosen = clip.frames[first : last + 1]
    loads = np.linspace(0.0, 1.0, len(chosen))
    if duration is not None:
        end = (last - first) * clip.frame_time
        if end < duration - _ROUNDED * clip.frame_time:
            raise BadInput(
                f"motion.bvh = '{clip.path}': its {len(chosen)} frames end at {end:g} s: expected "
                f"frames up to the end of the run, {duration:g} s"
            )
        loads = np.arange(len(chosen)) * (clip.frame_time / duration)
    number = names.index(joint)
    R, p = _placed(*_global_pose(clip.joints, number, chosen), placement)
    if rest == "first":
        R0, p0 = R[0], p[0]
    else:
        still = np.zeros((1, clip.frames.shape[1]))
        rest_pose = _placed(*_global_pose(clip.joints, number, still, at_offsets=True), placement)
        R0, p0 = rest_pose[0][0], rest_pose[1][0]
    turned = R @ R0.T
    return PoseTable(loads, turned, p - turned @ p0), p0


def _placed(R: Array, p: Array, placement: Placement | None) -> tuple[Array, Array]:
    """Return rotations (m, 3, 3) and positions (m, 3) in the scene."""
    where = placement or Placement()
    Q = exponential(np.asarray(where.rotation))
    return Q @ R, where.scale * p @ Q.T + np.asarray(where.translation)


def _global_pose(
    joints: list[Joint], number: int, frames: Array, at_offsets: bool = False
) -> tuple[Array, Array]:
    """Return rotations (m, 3, 3) and positions (m, 3) of a joint at the frames (m, channels).

    The pose x -> R x + d of a joint is its local one, then its parent's, up to the root. The local
    rotation of a joint is the product of its channels' in the file's order, R_1 R_2 R_3. Positions
    replace the offset, as in Blender's importer, unless all joints are at their offsets.
    """
    R, d = _local_pose(joints[number], frames, at_offsets)
    while (number := joints[number].parent) >= 0:
        turned, origin = _local_pose(joints[number], frames, at_offsets)
        R, d = turned @ R, np.einsum("mij,mj->mi", turned, d) + origin
    return R, d


def _local_pose(joint: Joint, frames: Array, at_offsets: bool) -> tuple[Array, Array]:
    """Return rotations (m, 3, 3) and positions (m, 3) of a joint in the frame of its parent."""
    from scipy.spatial.transform import Rotation

    count = len(frames)
    values = frames[:, joint.first : joint.first + len(joint.channels)]
    R, p = np.tile(np.eye(3), (count, 1, 1)), np.tile(joint.offset, (count, 1))
    for channel, value in zip(joint.channels, values.T, strict=True):
        axis = AXES.index(channel[0])
        if channel.endswith("rotation"):
            # Whole turns do not matter, and angles may be as large as numbers are.
            turn = np.outer(np.radians(np.fmod(value, 360.0)), np.eye(3)[axis])
            R = R @ Rotation.from_rotvec(turn).as_matrix()
        elif not at_offsets:
            p[:, axis] = value
    return R, p
