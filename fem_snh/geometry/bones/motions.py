"""Bones, and their motions: the map x = A X + c at a load, from functions and CSV files.

Random disturbances are added to them, as in production skinning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput, bad_value
from fem_snh.geometry.motions.motion_rows import MotionRows
from fem_snh.geometry.motions.moving import RigidMotion, pose_table
from fem_snh.geometry.shapes.shape import Array, Shape

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


@dataclass(frozen=True)
class Noise:
    r"""A random affine map at each frame, which is added to a bone's own.

    A point X of a bone with centre :math:`X_c` and length L is displaced by

    .. math:: a [L t + B (X - X_c)], \quad |t| \le 1/2, \quad \|B\|_F \le 1,

    with amplitude a. No point of the bone is displaced by more than a L, as none is farther than
    L/2 from the centre. The vector t is uniform in its ball, as is B in the ball of matrices.

    Parameters
    ----------
    amplitude : float
        The largest displacement a, in parts of the bone's length.
    seed : int
        Seed of the random numbers, together with the bone's name.
    frames : int
        Number of frames between load 0, which is not disturbed, and load 1.
    smooth : bool
        Whether the disturbance is a cubic spline in the load; otherwise it is linear between two
        frames.
    """

    amplitude: float
    seed: int
    frames: int
    smooth: bool = False

    def maps(self, name: str, centre: Array, length: float) -> Array:
        """Return the matrices [a B | c] of a bone at all frames, (frames + 1, 3, 4)."""
        random = np.random.default_rng([self.seed, *name.encode()])
        t = _in_ball(random, self.frames, 3) / 2
        B = _in_ball(random, self.frames, 9).reshape(-1, 3, 3)
        found = np.zeros((self.frames + 1, 3, 4))
        found[1:, :, :3] = self.amplitude * B
        found[1:, :, 3] = self.amplitude * (length * t - B @ centre)
        return found

    def motion(self, name: str, centre: Array, length: float) -> Callable[[float], Array]:
        """Return the matrix (3, 4) that is added to a bone's own, as a function of the load."""
        loads, maps = np.linspace(0.0, 1.0, self.frames + 1), self.maps(name, centre, length)
        if not self.smooth:
            return AffineTable(loads, maps).affine
        from scipy.interpolate import CubicSpline

        spline: Any = CubicSpline(loads, maps)
        return lambda load: np.asarray(spline(np.clip(load, 0.0, 1.0)))


def _in_ball(random: np.random.Generator, count: int, dimension: int) -> Array:
    """Return points (count, dimension) that are uniform in the unit ball."""
    direction = random.normal(size=(count, dimension))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    points: Array = direction * random.uniform(size=(count, 1)) ** (1 / dimension)
    return points


@dataclass(frozen=True)
class Bone:
    """A solid in the flesh, whose nodes follow its motion.

    Parameters
    ----------
    name : str
        Its name, by which ties between bones are decided.
    shape : Shape, optional
        The solid, at its reference position.
    group : str or int, optional
        A physical group of volumes, instead of a shape.
    motion : AffineMotion or callable, optional
        Its motion, or a function of the load that returns the (3, 4) matrix [A | c] of its map
        x = A X + c; without one it does not move.
    origin : (3,) tuple, optional
        A reference point [length], about which moments are given; default: the centre of the
        bounding box of the bone's nodes.
    noise : Noise, optional
        Random maps that are added to its motion.

    Raises
    ------
    BadInput
        Unless exactly one of ``shape`` and ``group`` is given.
    """

    name: str
    shape: Shape | None = None
    group: str | int | None = None
    motion: AffineMotion | Callable[[float], npt.ArrayLike] | None = None
    origin: tuple[float, float, float] | None = None
    noise: Noise | None = None

    def __post_init__(self) -> None:
        if (self.shape is None) == (self.group is None):
            found = "none" if self.shape is None else "both"
            raise BadInput(f"bone '{self.name}': expected a shape or a group; found {found}")

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [A | c] of x = A X + c [length] at a load, without noise."""
        if self.motion is None:
            return IDENTITY
        if callable(self.motion):
            return FunctionMotion(self.name, self.motion).affine(load)
        return self.motion.affine(load)
