"""Motions of bones from the rows of a CSV file."""

from __future__ import annotations

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.geometry.bones.motions import AffineMotion, AffineTable, RigidAffine
from fem_snh.geometry.motions.motion_rows import MotionRows
from fem_snh.geometry.motions.pose_table import pose_table


def bone_motion(rows: MotionRows, name: str, duration: float | None, rigid: bool) -> AffineMotion:
    """Return the motion of a bone.

    Between two rows, 3x4 matrices are linear in each entry. If they are rigid, and in a file of
    translations and rotation vectors, rotations are slerped and translations linear.

    Parameters
    ----------
    rows : MotionRows
        The rows of a file, of this bone and of others.
    name : str
        The bone.
    duration : float or None
        The length of the run [s], for a file with times.
    rigid : bool
        Whether the matrices are rotations and translations.

    Raises
    ------
    BadInput
        One line, for a file without rows of the bone, with rows that do not reach from the start to
        the end, and for a matrix A whose determinant is not positive, at a row or between two; with
        ``rigid``, for one that is no rotation.
    """
    rows = rows.of_bone(name)
    if rigid or not rows.has_matrices:
        return RigidAffine(pose_table(rows, duration))
    table = AffineTable(rows.loads(duration), rows.matrices())
    bad = table.first_singular()
    if bad is not None:
        determinant = np.linalg.det(table.matrices[bad, :, :3])
        where = f"{rows.path}, line {rows.lines[bad]}: bone '{name}'"
        if determinant > 0:
            raise BadInput(
                f"{where}: the entries a11 to a33 are linear from the row before, and their "
                "determinant is not positive between the two: expected rows that are closer, or "
                "rigid = true"
            )
        raise BadInput(
            f"{where}: the determinant of a11 to a33 is {determinant:.3g}: expected one > 0"
        )
    return table
