"""Files of motions: tables of poses and of affine maps (CSV), and skeletons (BVH)."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import write

_LOADS = (0.0, 0.3, 0.77, 1.0)
_MATRIX = [f"a{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3, 4)]


def make_table(random: Random, folder: Path) -> list[str]:
    """CSV files of poses or 3x4 matrices, in any order of columns, for an obstacle or for bones"""
    first = random.choice(("load", "time"))
    bones = random.choice((["ulna", "radius"], []))
    vectors, length = random.random() < 0.5, random.uniform(-2, 2)
    columns = ["x", "y", "z", "rx", "ry", "rz"] if vectors else _MATRIX
    order = random.sample(columns, len(columns))
    rows = [",".join([first, *(["bone"] if bones else []), *order])]
    for i in range(4):
        c = length * i / 3
        pose = [c, 0.0, 0.0, 0.0, c, 0.0]
        matrix = [1.0, 0.0, 0.0, c, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, -c]
        values = dict(zip(columns, map(repr, pose if vectors else matrix), strict=True))
        for bone in bones or [""]:
            named = [bone] if bone else []
            rows.append(",".join([repr(i / 3), *named, *(values[key] for key in order)]))
    state = write(random, folder / "motion.csv", "\n".join([*rows, ""]).encode())
    duration = "1.0" if first == "time" else ""
    kind = "bones" if bones else "obstacle"
    return [state, kind, duration, random.choice(("rigid", "")), repr(length), str(int(vectors))]


def _read_table(arguments: list[str]) -> int:
    """Read a table and evaluate its motions; those of a whole one are known at its rows."""
    from fem_snh.geometry.motion_files import bone_motion, read_motion, read_rows

    state, kind, duration, rigid, length, vectors = arguments
    end = float(duration) if duration else None
    if kind == "obstacle":
        motion = read_motion("motion.csv", end)
        maps = [lambda load: np.column_stack(motion.pose(load))]
    else:
        rows = read_rows("motion.csv", with_bones=True)
        maps = [bone_motion(rows, n, end, bool(rigid)).affine for n in ("ulna", "radius")]
    for at in maps:
        matrices = [at(load) for load in _LOADS]
        if kind == "obstacle" or rigid:
            _check_rigid(matrices)
        for matrix in matrices:
            assert np.isfinite(matrix).all() and np.linalg.det(matrix[:, :3]) > 0
        if state == "whole":
            for i in range(4):
                c = float(length) * i / 3
                turn = Rotation.from_rotvec([0, c * int(vectors), 0]).as_matrix()
                exact = np.column_stack([turn, [c, 0, 0 if int(vectors) else -c]])
                assert np.abs(at(i / 3) - exact).max() < 1e-9
    return 0


def _check_rigid(matrices: list[np.ndarray]) -> None:
    """Raise AssertionError unless matrices [R | c] are rigid motions."""
    for matrix in matrices:
        R = matrix[:, :3]
        assert np.isfinite(matrix).all()
        assert np.abs(R.T @ R - np.eye(3)).max() < 1e-9 and np.linalg.det(R) > 0


_SKELETON = """\
HIERARCHY
ROOT hips
{
  OFFSET 0.0 0.0 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT knee
  {
    OFFSET 0.0 -4.0 0.0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT ankle
    {
      OFFSET 0.0 -4.0 0.0
      CHANNELS 3 Zrotation Xrotation Yrotation
      End Site
      {
        OFFSET 0.0 0.0 1.0
      }
    }
  }
}
MOTION
Frames: 4
Frame Time: 0.25
"""


def make_skeleton(random: Random, folder: Path) -> list[str]:
    """BVH files of a leg"""
    frames = [[random.uniform(-90, 90) for _ in range(12)] for _ in range(4)]
    lines = [" ".join(map(repr, frame)) for frame in frames]
    data = (_SKELETON + "\n".join([*lines, ""])).encode()
    state = write(random, folder / "motion.bvh", data)
    joint = random.choice(("hips", "knee", "ankle"))
    rest, duration = random.choice(("first", "offset")), random.choice(("0.75", ""))
    return [state, joint, rest, duration, json.dumps(frames)]


def _read_skeleton(arguments: list[str]) -> int:
    """Read a skeleton and evaluate a joint; that of a whole one has the angles of its channels."""
    from fem_snh.geometry.bvh import joint_motion, read_bvh

    state, joint, rest, duration, numbers = arguments
    end = float(duration) if duration else None
    motion, origin = joint_motion(read_bvh("motion.bvh"), joint, rest, duration=end)
    assert np.isfinite(origin).all()
    _check_rigid([motion.affine(load) for load in _LOADS])
    if state == "whole":
        turns = []
        for frame in json.loads(numbers):
            position, turn = np.array(frame[:3]), Rotation.identity()
            for k in range(1 + ("hips", "knee", "ankle").index(joint)):
                position = position + turn.apply([0, -4.0 if k else 0, 0])
                turn = turn * Rotation.from_euler("ZXY", frame[3 * k + 3 : 3 * k + 6], degrees=True)
            turns.append((turn, position))
        if rest == "first":
            assert np.abs(origin - turns[0][1]).max() < 1e-9
        before = turns[0][0] if rest == "first" else Rotation.identity()
        for load, (turn, position) in zip((0, 1 / 3, 2 / 3, 1), turns, strict=True):
            matrix = motion.affine(load)
            assert np.abs(matrix[:, :3] - (turn * before.inv()).as_matrix()).max() < 1e-9
            assert np.abs(matrix[:, :3] @ origin + matrix[:, 3] - position).max() < 1e-9
    return 0


_PRELOAD = (
    "fem_snh.geometry.bvh",
    "fem_snh.geometry.motion_files",
    "scipy.spatial.transform",
    "scipy.interpolate",
)
FAMILIES = {
    "motion": Family(make_table, _read_table, _PRELOAD),
    "skeleton": Family(make_skeleton, _read_skeleton, _PRELOAD),
}
