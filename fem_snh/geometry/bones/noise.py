"""Random disturbances of bones' motions, as production skinning has them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fem_snh.geometry.bones.motions import AffineTable
from fem_snh.geometry.shapes.shape import Array


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
