"""Damaged files of motions: tables of poses and of affine maps (CSV), and skeletons (BVH)."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import mutate

_LOADS = (0.0, 0.3, 0.77, 1.0)
_MATRIX = [f"a{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3, 4)]


def make_table(random: Random, folder: Path) -> list[str]:
    """CSV files of poses or 3x4 matrices, for an obstacle or for bones"""
    first = random.choice(("load", "time"))
    kind = random.choice(("vectors", "matrices"))
    bones = random.choice((["ulna", "radius"], []))
    columns = ["x", "y", "z", "rx", "ry", "rz"] if kind == "vectors" else _MATRIX
    rows = [",".join([first, *(["bone"] if bones else []), *columns])]
    for i in range(4):
        for bone in bones or [""]:
            c = 0.1 * i
            pose = [c, 0.0, 0.0, 0.0, c, 0.0]
            matrix = [1.0, 0.0, 0.0, c, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, -c]
            values = pose if kind == "vectors" else matrix
            rows.append(",".join([repr(i / 3), *([bone] if bone else []), *map(repr, values)]))
    data = "\n".join([*rows, ""]).encode()
    if random.random() < 0.98:
        data = mutate(random, data)
    (folder / "motion.csv").write_bytes(data)
    duration = "1.0" if first == "time" else ""
    return ["bones" if bones else "obstacle", duration, random.choice(("rigid", ""))]


def _read_table(arguments: list[str]) -> int:
    """Read a table and evaluate its motions."""
    from fem_snh.geometry.bones import bone_motion
    from fem_snh.geometry.motions import read_motion
    from fem_snh.geometry.motions.motion_rows import read_rows

    kind, duration, rigid = arguments
    end = float(duration) if duration else None
    if kind == "obstacle":
        motion = read_motion("motion.csv", end)
        _check_rigid([np.column_stack(motion.pose(load)) for load in _LOADS])
        return 0
    rows = read_rows("motion.csv", with_bones=True)
    for name in ("ulna", "radius"):
        moved = bone_motion(rows, name, end, bool(rigid))
        for load in _LOADS:
            matrix = moved.affine(load)
            assert np.isfinite(matrix).all() and np.linalg.det(matrix[:, :3]) > 0
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
    frames = [" ".join(repr(round(0.3 * i * k, 3)) for k in range(12)) for i in range(4)]
    data = (_SKELETON + "\n".join([*frames, ""])).encode()
    if random.random() < 0.98:
        data = mutate(random, data)
    (folder / "motion.bvh").write_bytes(data)
    joint = random.choice(("hips", "knee", "ankle"))
    return [joint, random.choice(("first", "offset")), random.choice(("0.75", ""))]


def _read_skeleton(arguments: list[str]) -> int:
    """Read a skeleton and evaluate the motion of a joint."""
    from fem_snh.geometry.bones import joint_motion, read_bvh

    joint, rest, duration = arguments
    end = float(duration) if duration else None
    motion, origin = joint_motion(read_bvh("motion.bvh"), joint, rest, duration=end)
    assert np.isfinite(origin).all()
    _check_rigid([motion.affine(load) for load in _LOADS])
    return 0


_PRELOAD = (
    "fem_snh.geometry.bones",
    "fem_snh.geometry.motions",
    "scipy.spatial.transform",
    "scipy.interpolate",
)
FAMILIES = {
    "motion": Family(make_table, _read_table, _PRELOAD),
    "skeleton": Family(make_skeleton, _read_skeleton, _PRELOAD),
}
