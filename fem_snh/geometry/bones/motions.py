"""Affine motions of bones: the map x = A X + c at a load, from functions and CSV files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput, bad_value
from fem_snh.geometry.motions.motion_rows import MotionRows
from fem_snh.geometry.motions.moving import RigidMotion, pose_table
from fem_snh.geometry.shapes.shape import Array

#: The matrix of a bone that does not move.
IDENTITY: Array = np.eye(3, 4)
#: Determinants that count as zero between two matrices, over the larger of theirs: half a turn
#: about an axis leaves 1e-32.
_ROUNDING = 1e-12


class AffineMotion(Protocol):
    """An affine motion as a function of the load."""

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [A | c] of x = A X + c [length] at a load from 0 to 1."""


@dataclass(frozen=True)
class RigidAffine:
    """A rigid motion, of an obstacle's kind.

    Parameters
    ----------
    poses : RigidMotion
        Rotation and translation at a load.
    """

    poses: RigidMotion

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [R | c] at a load."""
        return np.column_stack(self.poses.pose(load))


@dataclass(frozen=True)
class AffineTable:
    """Affine maps at some loads, linear between them and constant beyond the ends.

    Attributes
    ----------
    loads : (m,) array
        Loads, ascending.
    matrices : (m, 3, 4) array
        Matrices [A | c].
    """

    loads: Array
    matrices: Array

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [A | c] at a load."""
        i = int(np.clip(np.searchsorted(self.loads, load), 1, len(self.loads) - 1))
        start, end = self.loads[i - 1 : i + 1]
        t = float(np.clip((load - start) / (end - start), 0.0, 1.0))
        matrix: Array = (1 - t) * self.matrices[i - 1] + t * self.matrices[i]
        return matrix

    def first_singular(self) -> int | None:
        """Return the number of the first row at which, or before which, det A is not positive."""
        A = self.matrices[:, :, :3]
        if not np.linalg.det(A[0]) > 0:
            return 0
        for i in range(1, len(A)):
            ends = np.linalg.det(A[i - 1 : i + 1])
            if not _least_determinant(A[i - 1], A[i]) > _ROUNDING * ends.max():
                return i
        return None


@dataclass(frozen=True)
class FunctionMotion:
    """An affine motion that a Python function returns.

    Parameters
    ----------
    name : str
        The bone's name, for messages.
    function : callable
        ``function(load)`` returns the (3, 4) matrix [A | c] at a load from 0 to 1.
    """

    name: str
    function: Callable[[float], npt.ArrayLike]

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [A | c] at a load.

        Raises
        ------
        BadInput
            If the function returns anything else, or if det A is not positive.
        """
        where = f"motion of bone '{self.name}' at load {load:.6g}"
        try:
            value = self.function(load)
        except Exception as error:  # a user's function may raise anything
            raise BadInput(f"{where}: {type(error).__name__}: {error}") from error
        try:
            matrix = np.array(value, dtype=float)
        except (TypeError, ValueError):
            raise bad_value(where, value, "a 3x4 matrix [A | c]") from None
        if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
            raise bad_value(where, value, "a 3x4 matrix [A | c] of finite numbers")
        check_determinant(where, matrix)
        return matrix


def check_determinant(where: str, matrix: Array) -> None:
    """Raise BadInput unless the determinant of A of a matrix [A | c] is positive."""
    determinant = np.linalg.det(matrix[:, :3])
    if not determinant > 0:
        raise BadInput(f"{where}: det A = {determinant:.3g}: expected a determinant > 0")


def _least_determinant(A: Array, B: Array) -> float:
    """Return the smallest determinant of (1 - t) A + t B for t from 0 to 1: a cubic in t."""
    t = np.linspace(0.0, 1.0, 4)
    cubic = np.polyfit(t, [np.linalg.det((1 - s) * A + s * B) for s in t], 3)
    turning = np.roots(np.polyder(cubic))
    inside = turning.real[(np.abs(turning.imag) < 1e-12) & (turning.real > 0) & (turning.real < 1)]
    return min(np.linalg.det((1 - s) * A + s * B) for s in (0.0, 1.0, *inside))


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
