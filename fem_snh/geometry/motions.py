"""Motions as functions of the load; rigid shapes and bones that follow motions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from fem_snh.arrays import Array, ArrayLike
from fem_snh.errors import BadInput, bad_value
from fem_snh.geometry.shapes.shape import Evaluation, Shape, rotated

#: The matrix [A | c] of a bone that does not move.
IDENTITY: Array = np.eye(3, 4)
#: Points of the polynomial that interpolates a smooth motion: exact up to degree 5 in the load.
_POINTS = 6
#: Largest error of the polynomial between its points, relative to the largest second derivative
#: times the square of a step, for a motion that counts as smooth. A motion of constant frequency
#: has 1e-4 at 6 steps a period. So has a table with a point every 0.03 steps, whose kinks then
#: change the acceleration by 0.2 %.
_SMOOTH = 1e-4
#: Further error that is allowed, relative to the displacement: rounding.
_ROUNDING = 1e-14
#: The last load, 1, plus the rounding error of the sum of steps.
_LAST = 1 + 1e-9


class Pose(NamedTuple):
    """A map x = R X + c of reference points X.

    Attributes
    ----------
    rotation : (3, 3) array
        The matrix R: a rotation for a rigid motion, any matrix for a bone.
    translation : (3,) array
        The translation c [length].
    """

    rotation: Array
    translation: Array

    def apply(self, X: Array) -> Array:
        """Return the points R X + c (n, 3)."""
        return X @ self.rotation.T + self.translation

    def invert(self, x: Array) -> Array:
        """Return the points R^T (x - c) (n, 3): the inverse of `apply` if R is a rotation."""
        return (x - self.translation) @ self.rotation


#: The pose of a shape that does not move.
AT_REST = Pose(np.eye(3), np.zeros(3))


class Motion:
    """An affine motion as a function of the load; the motion of an obstacle is rigid."""

    def pose(self, load: float) -> Pose:
        """Return the map x = R X + c of reference points at a load from 0 to 1."""
        raise NotImplementedError(f"{type(self).__name__}.pose")

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [A | c] of x = A X + c [length] at a load from 0 to 1."""
        return np.column_stack(self.pose(load))


@dataclass(frozen=True)
class DisplacementMotion(Motion):
    """A rigid motion given by its displacement field, as ``[[move]]`` of a scene defines one.

    Parameters
    ----------
    displacement : callable
        The displacements (n, 3) of reference points X (n, 3) at a load: ``displacement(X, load)``.
    """

    displacement: Callable[[Array, float], Array]

    def pose(self, load: float) -> Pose:
        # The rotation does not depend on the place: the images of the origin and of the axes.
        X = np.vstack([np.zeros(3), np.eye(3)])
        x = X + self.displacement(X, load)
        return Pose((x[1:] - x[0]).T, x[0])


@dataclass(frozen=True)
class PoseTable(Motion):
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
        """Return the pose at a load; beyond the ends of the table, the pose at the nearer end."""
        load = float(np.clip(load, self.loads[0], self.loads[-1]))
        c = np.array([np.interp(load, self.loads, column) for column in self.translations.T])
        return Pose(self._slerp(load).as_matrix(), c)


@dataclass(frozen=True)
class AffineTable(Motion):
    """Affine maps at some loads; entries are linear between loads and constant beyond the ends.

    Attributes
    ----------
    loads : (m,) array
        Loads, ascending, two or more.
    matrices : (m, 3, 4) array
        Matrices [A | c] of x = A X + c; c [length].
    """

    loads: Array
    matrices: Array

    def pose(self, load: float) -> Pose:
        """Return the map at a load; its ``rotation`` is A."""
        i = int(np.clip(np.searchsorted(self.loads, load), 1, len(self.loads) - 1))
        start, end = self.loads[i - 1 : i + 1]
        t = float(np.clip((load - start) / (end - start), 0.0, 1.0))
        matrix = (1 - t) * self.matrices[i - 1] + t * self.matrices[i]
        return Pose(matrix[:, :3], matrix[:, 3])


def check_determinant(where: str, matrix: Array) -> None:
    """Raise BadInput unless the determinant of A of a matrix [A | c] is positive."""
    determinant = np.linalg.det(matrix[:, :3])
    if not determinant > 0:
        raise BadInput(f"{where}: det A = {determinant:.3g}: expected a determinant > 0")


@dataclass(frozen=True)
class MovingShape:
    """A rigid shape in motion.

    Parameters
    ----------
    shape : Shape
        The shape at its reference position.
    motion : Motion, optional
        The rigid motion; without it the shape does not move.

    Notes
    -----
    The signed distance moves with the shape: :math:`d(x, \\lambda) = d(R^T(x - c))`, with gradient
    :math:`R\\,\\nabla d` and Hessian :math:`R\\,\\nabla^2 d\\,R^T`.
    """

    shape: Shape
    motion: Motion | None = None

    def pose(self, load: float) -> Pose:
        """Return the pose at a load: R (3, 3) and c (3,) [length] of x = R X + c."""
        if self.motion is None:
            return AT_REST
        return self._pose(load)

    @cached_property
    def _pose(self) -> Callable[[float], Pose]:
        """The motion's pose, which contact asks for at the same load many times."""
        assert self.motion
        return lru_cache(maxsize=4)(self.motion.pose)

    def affine(self, load: float) -> list[list[float]]:
        """Return the pose as the three rows [R | c] of a 3x4 matrix, for run.json."""
        return np.column_stack(self.pose(load)).tolist()

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
        if not len(x):  # most obstacles are far from a body most of the time
            return Evaluation(np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3)))
        if self.motion is None:
            return self.shape.evaluate(x)
        pose = self.pose(load)
        R = pose.rotation
        distance, gradient, hessian = self.shape.evaluate(pose.invert(x))
        return Evaluation(distance, gradient @ R.T, rotated(hessian, R))

    def distance(self, x: Array, load: float) -> Array:
        """Return the signed distance (n,) [length] of points x (n, 3) at a load: see `evaluate`."""
        return self.shape.distance(x if self.motion is None else self.pose(load).invert(x))

    def displacement(self, x: Array, start: float, end: float) -> Array:
        """Return the displacements between two loads of points that move with the shape.

        Parameters
        ----------
        x : (n, 3) array
            Positions of the points at the load ``start`` [length].
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


@dataclass(frozen=True)
class Noise:
    r"""Random affine displacements at equidistant loads, which are added to a bone's motion.

    A point X of a bone with centre :math:`X_c` and length L is displaced by

    .. math:: a [L t + B (X - X_c)], \quad |t| \le 1/2, \quad \|B\|_F \le 1,

    with amplitude a. L is twice the largest distance of a node from the centre, so no node is
    displaced by more than a L. The vector t and the matrix B are uniform in their balls.

    Parameters
    ----------
    amplitude : float
        The largest displacement over L, the number a.
    seed : int
        Seed of the random numbers, together with the bone's name.
    frames : int
        Number of equal intervals of the load, linear in each; the displacement at load 0 is zero.
    """

    amplitude: float
    seed: int
    frames: int

    def maps(self, name: str, centre: Array, length: float) -> Array:
        """Return the matrices [a B | c] of the displacements at all loads, (frames + 1, 3, 4)."""
        random = np.random.default_rng([self.seed, *name.encode()])
        t = _in_ball(random, self.frames, 3) / 2
        B = _in_ball(random, self.frames, 9).reshape(-1, 3, 3)
        found = np.zeros((self.frames + 1, 3, 4))
        found[1:, :, :3] = self.amplitude * B
        found[1:, :, 3] = self.amplitude * (length * t - B @ centre)
        return found

    def motion(self, name: str, centre: Array, length: float) -> Callable[[float], Array]:
        """Return the matrix (3, 4) to add to a bone's [A | c], as a function of the load."""
        loads = np.linspace(0.0, 1.0, self.frames + 1)
        return AffineTable(loads, self.maps(name, centre, length)).affine


def _in_ball(random: np.random.Generator, count: int, dimension: int) -> Array:
    """Return points (count, dimension) that are uniform in the unit ball."""
    direction = random.normal(size=(count, dimension))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return direction * random.uniform(size=(count, 1)) ** (1 / dimension)


@dataclass(frozen=True)
class Bone:
    """A solid inside of the body, with a prescribed motion that the nodes in it follow.

    Parameters
    ----------
    name : str
        The name; a node equally deep in several bones follows the one whose name sorts first.
    shape : Shape, optional
        The solid, at its reference position.
    group : str or int, optional
        A physical group of volumes, instead of a shape.
    motion : Motion or callable, optional
        The motion, or a function of the load that returns the (3, 4) matrix [A | c] of
        x = A X + c; without it the bone does not move.
    origin : (3,) tuple, optional
        A reference point [length], about which moments are given; default: the centre of the
        bounding box of the bone's nodes.
    noise : Noise, optional
        Random displacements that are added to the motion.

    Raises
    ------
    BadInput
        Unless exactly one of ``shape`` and ``group`` is given.
    """

    name: str
    shape: Shape | None = None
    group: str | int | None = None
    motion: Motion | Callable[[float], ArrayLike] | None = None
    origin: tuple[float, float, float] | None = None
    noise: Noise | None = None

    def __post_init__(self) -> None:
        if (self.shape is None) == (self.group is None):
            found = "none" if self.shape is None else "both"
            raise BadInput(f"bone '{self.name}': expected a shape or a group; found {found}")

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [A | c] of x = A X + c [length] at a load, without noise.

        Raises
        ------
        BadInput
            If a function fails, or does not return a finite (3, 4) matrix, or if det A <= 0.
        """
        if self.motion is None:
            return IDENTITY
        where = f"motion of bone '{self.name}' at load {load:.6g}"
        at = self.motion.affine if isinstance(self.motion, Motion) else self.motion
        try:
            matrix = np.array(at(load), dtype=float)
        except Exception as error:  # a user's function may raise anything
            raise BadInput(f"{where}: {type(error).__name__}: {error}") from error
        if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
            raise bad_value(where, matrix, "a 3x4 matrix [A | c] of finite numbers")
        check_determinant(where, matrix)
        return matrix


def path_rates(
    path: Callable[[float], Array], load: float, step: float
) -> tuple[Array, Array, Array]:
    r"""Return a motion at a load, and its first two derivatives by the load.

    An entry that is smooth within a step of the load is differentiated as a polynomial through
    points of the motion. An entry with kinks, as a table has at its points, is differentiated by
    central differences of the step h,

    .. math:: v = \frac{u_{n+1} - u_{n-1}}{2 h}, \qquad a = \frac{u_{n+1} - 2 u_n + u_{n-1}}{h^2} .

    Wherever the kinks are, the sum of :math:`h a` over steps is then the change of the velocity,
    and the work of the inertial forces by the trapezoidal rule is the change of the kinetic energy.
    At the last load, beyond which a motion is not known, the differences are one-sided.

    Parameters
    ----------
    path : callable
        The motion, an array as a function of the load. If it is collective, so is this function.
    load : float
        The load.
    step : float
        The size of the step that ends at the load; negative at the start of the first step, to use
        higher loads only.

    Returns
    -------
    u, v, a : arrays
        The motion and its derivatives, of one shape.
    """
    u = path(load)
    if step < 0:
        window, points = (-1.0, 0.0), np.arange(-1, 1)
    elif load + step <= _LAST:
        window, points = (-1.0, 1.0), np.arange(-1, 2)
    else:
        behind = load / step
        window, points = (-min(2.0, behind), 0.0), np.arange(-min(3, round(behind)), 1)

    def changes(offsets: Array) -> Array:
        """Return the changes of the motion at some steps from the load, (offsets, ...)."""
        # Differences from the present value: a constant displacement has no rounding error.
        return np.stack([path(load + k * step) - u if k else np.zeros_like(u) for k in offsets])

    fine = np.linspace(*window, _POINTS)
    between = (fine[1:] + fine[:-1]) / 2
    values = changes(fine)
    v, a = np.tensordot(_derivatives(fine), values, axes=1)
    expected = np.tensordot(_interpolation(fine, between), values, axes=1)
    misfit = abs(changes(between) - expected).max(axis=0)
    bend = abs(np.diff(values, 2, axis=0)).max(axis=0) / (fine[1] - fine[0]) ** 2
    smooth = misfit <= _SMOOTH * bend + _ROUNDING * abs(u)
    coarse_v, coarse_a = np.tensordot(_derivatives(points), changes(points), axes=1)
    v, a = np.where(smooth, v, coarse_v), np.where(smooth, a, coarse_a)
    return u, v / step, a / step**2


def _derivatives(points: Array) -> Array:
    """Return the weights (2, points) that give the first two derivatives at 0 from values."""
    return _weights(points, np.eye(len(points), 3)[:, 1:] * (1, 2))


def _interpolation(points: Array, others: Array) -> Array:
    """Return the weights (others, points) that give the values at ``others`` from values."""
    return _weights(points, np.vander(others, len(points), increasing=True).T)


def _weights(points: Array, moments: Array) -> Array:
    """Return weights w, one row for each column m of ``moments``: sum_j w_j x_j^k = m_k."""
    return np.linalg.solve(np.vander(points, increasing=True).T, moments).T
