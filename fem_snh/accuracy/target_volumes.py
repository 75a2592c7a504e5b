"""The volumes of cells with which the error of goals needs the fewest cells."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: Parts into which the edges of a cell are divided at most from one level to the next.
_MOST_PARTS = 4.0


def target_volumes(
    volumes: Array, weights: Array, degree: int, growth: float, dim: int = 3
) -> Array:
    r"""Return the volumes of cells with which an error needs the fewest cells.

    A cell of size h has the weight :math:`\eta = c\, h^{d + 2p}` with a local constant c, as the
    goal's error is a product of two errors of order p. Of all meshes with the same sum of the
    weights, the fewest cells have those of equal weight per :math:`d / (d + 2p)`: the number of
    cells in the place of one is proportional to :math:`\eta^{d/(d+2p)}`.

    Parameters
    ----------
    volumes, weights : (cells,) array
        The volumes [length^dim], and the sizes of the errors of the cells.
    degree : int
        Degree p of the displacement.
    growth : float
        The factor by which the number of cells is to be larger.
    dim : int, optional
        Dimension d of the mesh.
    """
    power = dim / (dim + 2 * degree)
    density = np.maximum(weights, 0.0) ** power
    if not density.sum() > 0:
        return np.asarray(volumes / growth)
    low, high = 0.0, 2 * growth * len(volumes) / density.sum() * max(1.0, len(volumes))
    for _ in range(100):
        middle = (low + high) / 2
        if np.maximum(1.0, middle * density).sum() < growth * len(volumes):
            low = middle
        else:
            high = middle
    parts = np.clip(high * density, 1.0, _MOST_PARTS**dim)
    return np.asarray(volumes / parts)
