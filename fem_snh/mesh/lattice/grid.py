"""The regular grid of a lattice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput, bad_value

Array = npt.NDArray[Any]
Integers = npt.NDArray[np.int64]

#: Largest number of cells in the box of the body: an array of one double each takes 0.4 GB.
_MAX_CELLS = 50_000_000
#: Part of a cell by which a body may be larger than a whole number of cells: rounding error, also
#: that of single precision in STL files.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Grid:
    """Cubes of equal size in the box of a body, numbered by (i, j, k) from its lowest corner.

    Attributes
    ----------
    origin : (3,) array
        The lowest corner [length].
    size : float
        The edge of a cube [length].
    shape : (3,) int array
        Number of cubes along each axis.
    """

    origin: Array
    size: float
    shape: Integers

    @classmethod
    def around(cls, bounds: Array, size: float, key: str = "cell") -> Grid:
        """Return the smallest grid that holds a box and has its centre.

        Parameters
        ----------
        bounds : (2, 3) array
            Lowest and highest coordinates [length].
        size : float
            The edge of a cube [length].
        key : str
            Its name in messages.

        Raises
        ------
        BadInput
            For an infinite box, cubes that are larger than it, and too many of them.
        """
        if not np.isfinite(bounds).all():
            raise BadInput("expected a body of finite size, no plane and no infinite cylinder")
        extent = bounds[1] - bounds[0]
        if not size < extent.max():
            accepted = f"a number < {extent.max():.4g}, the largest extent of the body"
            raise bad_value(key, size, accepted)
        shape = np.maximum(np.ceil(extent / size - _ROUNDING), 1.0)
        if shape.prod() > _MAX_CELLS:
            least = (extent.prod() / _MAX_CELLS) ** (1 / 3)
            accepted = f"a number > {least:.2g}, for at most {_MAX_CELLS:,} cells around the body"
            raise bad_value(key, size, accepted)
        return cls(bounds.mean(axis=0) - 0.5 * size * shape, size, shape.astype(np.int64))

    def key(self, cells: Integers) -> Integers:
        """Return one number for each of the cells (..., 3), also those just outside of the grid."""
        _, ny, nz = self.shape + 2
        i, j, k = np.moveaxis(cells + 1, -1, 0)
        key: Integers = (i * ny + j) * nz + k
        return key

    def rows(self, cells: Integers, wanted: Integers) -> tuple[Integers, Integers]:
        """Return which of ``wanted`` (n, 3) are among sorted cells (m, 3), and their rows there."""
        keys, key = self.key(cells), self.key(wanted)
        at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        found = np.flatnonzero(keys[at] == key)
        return found, at[found]

    def centres(self, cells: Integers) -> Array:
        """Return the centres of cells (n, 3)."""
        return self.origin + self.size * (cells + 0.5)


def cells_of_box(low: Integers, high: Integers) -> Integers:
    """Return (i, j, k) from ``low`` to before ``high``, (n, 3), the last index fastest."""
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
