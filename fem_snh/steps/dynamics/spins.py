"""How far the cells of a mesh turn in a step, from their velocity."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: Added to the inertia of a cell's nodes, relative to its trace: that of a line about itself
#: is zero. It is above rounding.
_SMALLEST = 1e-14


def cell_rotations(x: Array, v: Array, time: float) -> Array:
    r"""Return the rotations of cells that keep their present spin for a time.

    The spin :math:`\omega` of a cell is the angular velocity that is closest to the velocity of its
    nodes in least squares,

    .. math:: \sum_a \left(|r_a|^2 I - r_a r_a^T\right) \omega = \sum_a r_a \times v_a ,

    with the nodes' positions r from their mean. The rotation is Cayley's map of
    :math:`t \omega / 2`, by which the trapezoidal rule turns a rigid body.

    Parameters
    ----------
    x, v : (cells, nodes, 3)
        Positions [m] and velocities [m/s] of the nodes of each cell.
    time : float
        The time t [s].

    Returns
    -------
    (cells, 3, 3)
    """
    r = x - x.mean(axis=1, keepdims=True)
    squares = np.einsum("cai,caj->cij", r, r)
    inertia = np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    w = np.linalg.solve(inertia * (1 + _SMALLEST) - squares, np.cross(r, v).sum(axis=1)[..., None])
    half = time / 2 * w[..., 0]
    skew = np.zeros((len(half), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[:, j, i], skew[:, i, j] = half[:, k], -half[:, k]
    factor = 2 / (1 + (half**2).sum(axis=1))[:, None, None]
    return np.asarray(np.eye(3) + factor * (skew + skew @ skew))
