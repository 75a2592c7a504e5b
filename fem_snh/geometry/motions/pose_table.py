"""Rigid motions from a table of poses, in a CSV file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.geometry.motions.motion_rows import ROTATION, TRANSLATION, MotionRows, read_rows
from fem_snh.geometry.motions.moving import Pose
from fem_snh.geometry.shapes.shape import Array

#: Largest difference of R^T R from the identity: a table of 6 digits has 1e-6 in each entry.
_RIGID = 1e-5
#: Largest rotation between two rows [rad]: the shortest way is not unique at half a turn.
_HALF_TURN = np.pi * (1 - 1e-6)


@dataclass(frozen=True)
class PoseTable:
    """Poses at some loads; between them, translations are linear and rotations slerped.

    Attributes
    ----------
    loads : (m,) array
        Loads, ascending, from 0 or less to 1 or more.
    rotations : (m, 3, 3) array
        Rotation matrices.
    translations : (m, 3) array
        Translations c of x = R X + c [length].
    """

    loads: Array
    rotations: Array
    translations: Array

    @cached_property
    def _slerp(self) -> Any:
        from scipy.spatial.transform import Rotation, Slerp

        return Slerp(self.loads, Rotation.from_matrix(self.rotations))

    def pose(self, load: float) -> Pose:
        """Return the pose at a load; beyond the ends of the table, that of its end."""
        load = float(np.clip(load, self.loads[0], self.loads[-1]))
        c = np.array([np.interp(load, self.loads, column) for column in self.translations.T])
        return Pose(self._slerp(load).as_matrix(), c)


def read_motion(path: str | Path, duration: float | None = None) -> PoseTable:
    """Read a rigid motion from a CSV file with a line of column names.

    Parameters
    ----------
    path : str or Path
        The file. Its first column is ``load`` or ``time``; then a translation ``x, y, z`` and a
        rotation vector ``rx, ry, rz`` (axis times angle [rad], about the origin, before the
        translation; may be left out), or the entries ``a11, a12, ..., a34`` of a 3x4 matrix
        [R | c], row by row. Lines that begin with # are comments.
    duration : float, optional
        The length of the run [s], at which the load is 1; without it the table has loads.

    Raises
    ------
    BadInput
        One line, for a file that cannot be read, with other columns, with times or loads that do
        not ascend or do not reach from the start to the end, with a matrix that is not a rotation
        and a translation, or with half a turn or more between two rows.
    """
    return pose_table(read_rows(path), duration)


def pose_table(rows: MotionRows, duration: float | None) -> PoseTable:
    """Return the rigid motion of the rows of a file. Raises BadInput as `read_motion` does."""
    path, lines, loads = rows.path, rows.lines, rows.loads(duration)
    if rows.has_matrices:
        matrices = rows.matrices()
        return PoseTable(loads, _rotations(path, lines, matrices[:, :, :3]), matrices[:, :, 3])
    return PoseTable(loads, _from_vectors(rows), rows.columns(TRANSLATION))


def _from_vectors(rows: MotionRows) -> Array:
    """Return the rotation matrices (m, 3, 3) of the rotation vectors."""
    from scipy.spatial.transform import Rotation

    if not set(ROTATION) <= set(rows.names):
        return np.tile(np.eye(3), (len(rows.numbers), 1, 1))
    vectors = rows.columns(ROTATION)
    _check_turns(rows.path, rows.lines, np.linalg.norm(np.diff(vectors, axis=0), axis=1))
    matrices: Array = Rotation.from_rotvec(vectors).as_matrix()
    return matrices


def _rotations(path: Path, lines: list[int], matrices: Array) -> Array:
    """Return rotations (m, 3, 3): the closest ones to matrices that are rigid up to rounding."""
    from scipy.spatial.transform import Rotation

    errors = np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max(axis=(1, 2))
    rigid = (errors <= _RIGID) & (np.linalg.det(matrices) > 0)
    for i in np.flatnonzero(~rigid)[:1]:
        raise BadInput(
            f"{path}, line {lines[i]}: expected a rotation in the first three columns of the 3x4 "
            f"matrix; R^T R differs from the identity by {errors[i]:.1e}, "
            f"det R = {np.linalg.det(matrices[i]):g}"
        )
    rotations = Rotation.from_matrix(matrices)
    _check_turns(path, lines, (rotations[:-1].inv() * rotations[1:]).magnitude())
    closest: Array = rotations.as_matrix()
    return closest


def _check_turns(path: Path, lines: list[int], angles: Array) -> None:
    """Raise BadInput for half a turn or more between two rows."""
    for i in np.flatnonzero(angles >= _HALF_TURN)[:1]:
        raise BadInput(
            f"{path}, line {lines[i + 1]}: a turn of {np.degrees(angles[i]):.0f} degrees from the "
            "row before: expected less than 180, so that its direction is known"
        )
