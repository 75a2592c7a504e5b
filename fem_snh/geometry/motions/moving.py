"""Rigid motions of obstacles: their pose at a load, and what a point of theirs moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.geometry.motions.motion_rows import ROTATION, TRANSLATION, MotionRows, read_rows
from fem_snh.geometry.shapes.shape import Array, Evaluation, Shape


class Pose(NamedTuple):
    """A rigid map x = R X + c.

    Attributes
    ----------
    rotation : (3, 3) array
        R, with R^T R = I and det R = 1.
    translation : (3,) array
        c [length].
    """

    rotation: Array
    translation: Array

    def apply(self, X: Array) -> Array:
        """Return the points R X + c (n, 3)."""
        x: Array = X @ self.rotation.T + self.translation
        return x

    def invert(self, x: Array) -> Array:
        """Return the points R^T (x - c) (n, 3)."""
        X: Array = (x - self.translation) @ self.rotation
        return X


class RigidMotion(Protocol):
    """A rigid motion as a function of the load."""

    def pose(self, load: float) -> Pose:
        """Return the pose at a load from 0 to 1."""


@dataclass(frozen=True)
class DisplacementMotion:
    """A rigid motion that a displacement field defines, as the scene's ``[[move]]`` has it.

    Parameters
    ----------
    displacement : callable
        The displacements (n, 3) of reference points X (n, 3) at a load: ``displacement(X, load)``.
    """

    displacement: Callable[[Array, float], Array]

    def pose(self, load: float) -> Pose:
        """Return the pose at a load from 0 to 1."""
        # The rotation does not depend on the place: the images of the origin and of the axes.
        X = np.vstack([np.zeros(3), np.eye(3)])
        x = X + self.displacement(X, load)
        return Pose((x[1:] - x[0]).T, x[0])


@dataclass(frozen=True)
class MovingShape:
    """A rigid shape in motion.

    Parameters
    ----------
    shape : Shape
        The shape at its reference position.
    motion : RigidMotion, optional
        Its motion; without one it does not move.

    Notes
    -----
    Its distance moves with it: :math:`d(x, \\lambda) = d(R^T(x - c))`, with gradient
    :math:`R\\,\\nabla d` and Hessian :math:`R\\,\\nabla^2 d\\,R^T`.
    """

    shape: Shape
    motion: RigidMotion | None = None

    def pose(self, load: float) -> Pose:
        """Return the pose at a load: R (3, 3) and c (3,) [length] of x = R X + c."""
        if self.motion is None:
            return Pose(np.eye(3), np.zeros(3))
        return self.motion.pose(load)

    def affine(self, load: float) -> list[list[float]]:
        """Return the pose as the three rows [R | c] of a 3x4 matrix, as run.json has it."""
        R, c = self.pose(load)
        return [list(map(float, row)) for row in np.column_stack([R, c])]

    def evaluate(self, x: Array, load: float) -> Evaluation:
        """Return the signed distance of points at a load, with its derivatives.

        Parameters
        ----------
        x : (n, 3) array
            Points [length].
        load : float
            The load, from 0 to 1.

        Returns
        -------
        Evaluation
            distance (n,) [length], positive outside; gradient (n, 3); hessian (n, 3, 3) [1/length].
        """
        if self.motion is None:
            return self.shape.evaluate(x)
        pose = self.pose(load)
        R = pose.rotation
        distance, gradient, hessian = self.shape.evaluate(pose.invert(x))
        return Evaluation(distance, gradient @ R.T, R @ hessian @ R.T)

    def displacement(self, x: Array, start: float, end: float) -> Array:
        """Return what points that move with the obstacle are displaced between two loads.

        Parameters
        ----------
        x : (n, 3) array
            Where the points are at the load ``start`` [length].
        start, end : float
            The loads; ``end`` may be the lower one.

        Returns
        -------
        (n, 3) array
            Displacements [length], from ``start`` to ``end``.
        """
        if self.motion is None or start == end:
            return np.zeros_like(x, dtype=float)
        return self.pose(end).apply(self.pose(start).invert(x)) - x


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
