"""Files of motions: tables of poses and of affine maps (CSV)."""

from __future__ import annotations

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
    from fem_snh.geometry.motions import Bone

    state, kind, duration, rigid, length, vectors = arguments
    end = float(duration) if duration else None
    if kind == "obstacle":
        motion = read_motion("motion.csv", end)
        maps = [lambda load: np.column_stack(motion.pose(load))]
    else:
        names = "ulna", "radius"
        rows = read_rows("motion.csv", names)
        motions = [bone_motion("motion.csv", rows, name, end, bool(rigid)) for name in names]
        maps = [Bone("bone", group="bone", motion=motion).affine for motion in motions]
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


_PRELOAD = (
    "fem_snh.geometry.motion_files",
    "scipy.spatial.transform",
    "scipy.interpolate",
)
FAMILIES = {
    "motion": Family(make_table, _read_table, _PRELOAD),
}
