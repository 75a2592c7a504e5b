"""Read a skeleton and its motion from a BVH file (Biovision hierarchy)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fem_snh.choices import LARGEST_NUMBER
from fem_snh.errors import BadInput, nearest_file, shown
from fem_snh.files import read_text
from fem_snh.geometry.shapes.shape import Array

#: The first letters of channels.
AXES = "XYZ"
_CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in AXES)


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
        try:
            value = float(found)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise self.error(found, "a finite number")
        if abs(value) > LARGEST_NUMBER:
            raise self.error(found, f"a number of a size up to {LARGEST_NUMBER:g}")
        return value

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
    try:
        text = read_text(path, encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput(f"motion.bvh = '{path}': expected a BVH file of UTF-8 text") from None
    except OSError as error:
        near = nearest_file(path)
        raise BadInput(f"cannot read the motion {path}: {error.strerror}{near}") from None
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
