"""The cells around a probe of the stress, whose mean over them is weighted by the distance."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: The weight around a point ends at so many radii, where it is 1e-8. Cells there have at most so
#: many radii, for which the largest quadrature degree integrates the weight to 1e-3.
REACH, MOST_RADII = 3.0, 6.0


def sizes_near(x: Array, point: Array, radius: float) -> Array:
    """Return the sizes of the cells that the weight around a point reaches; 0 for all others.

    Parameters
    ----------
    x : (cells, nodes, dim) array
        The nodes of the cells [m].
    point : (dim,) array
        The point [m].
    radius : float
        Its radius [m].
    """
    low, high = x.min(axis=1), x.max(axis=1)
    outside = np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0), axis=1)
    near = outside <= REACH * radius
    return np.where(near, (high - low).max(axis=1), 0.0)
