"""The regular grid of a lattice, and how much of each cell a solid fills, by samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput, bad_value
from fem_snh.geometry.shapes import Shape

Array = npt.NDArray[Any]
Integers = npt.NDArray[np.int64]
Coverage = npt.NDArray[np.float32]

#: Largest number of cells in the box of the body: an array of one double each takes 0.4 GB.
_MAX_CELLS = 50_000_000
#: Part of a cell by which a body may be larger than a whole number of cells: rounding error, also
#: that of single precision in STL files.
_ROUNDING = 1e-6
#: Edge, in cells, of the blocks of cells that are left out together if they are outside.
_BLOCK = 4
#: Cells whose samples are evaluated together, which bounds the memory.
_BATCH = 20_000


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
        return (i * ny + j) * nz + k

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


class Samples(NamedTuple):
    """The cells that a solid fills, whole or in part.

    Attributes
    ----------
    cells : (n, 3) int array
        Their (i, j, k) in the grid, sorted.
    coverage : (n, s, s, s) float32 array
        The filled part of each of the s x s x s cubes of a cell, from 0 to 1.
    """

    cells: Integers
    coverage: Coverage

    @property
    def fractions(self) -> Array:
        """The filled part of each cell, (n,)."""
        return np.asarray(self.coverage.mean(axis=(1, 2, 3), dtype=float))


def sample_shape(shape: Shape, grid: Grid, samples: int) -> tuple[Samples, Integers]:
    """Return how much of each cell a shape fills, and the cells that its surface may cut.

    A cube of edge a, whose centre has the signed distance d, counts as filled by the part
    min(max(1/2 - d/a, 0), 1), which is exact for planes parallel to its faces and in the mean over
    the positions of any plane. The volume of a solid with a smooth surface has an error of a^2.

    Parameters
    ----------
    shape : Shape
        The solid; where its distance is not exact, it is smaller in magnitude than the true one.
    grid : Grid
        The cells.
    samples : int
        Cubes along an edge of a cell.
    """
    # A distance changes by at most the length of a way (Lipschitz constant 1): a cube whose
    # centre is further away than its corners does not meet the surface.
    blocks = cells_of_box(np.zeros(3, np.int64), -(-grid.shape // _BLOCK))
    centres = grid.origin + grid.size * _BLOCK * (blocks + 0.5)
    blocks = blocks[shape.distance(centres) < grid.size * _BLOCK * np.sqrt(0.75)]
    within = cells_of_box(np.zeros(3, np.int64), np.full(3, _BLOCK))
    cells = (_BLOCK * blocks[:, None] + within).reshape(-1, 3)
    cells = cells[np.all(cells < grid.shape, axis=1)]
    distance, reach = shape.distance(grid.centres(cells)), grid.size * np.sqrt(0.75)
    cells, distance = cells[distance < reach], distance[distance < reach]
    coverage = np.ones((len(cells), *[samples] * 3), dtype=np.float32)
    cut = np.flatnonzero(distance > -reach)
    edge = grid.size / samples
    offsets = edge * (cells_of_box(np.zeros(3, np.int64), np.full(3, samples)) + 0.5)
    for start in range(0, len(cut), _BATCH):
        some = cut[start : start + _BATCH]
        corners = grid.origin + grid.size * cells[some]
        d = shape.distance((corners[:, None] + offsets).reshape(-1, 3))
        coverage[some] = np.clip(0.5 - d / edge, 0, 1).reshape(-1, *[samples] * 3)
    return sorted_samples(grid, cells, coverage), cells[cut]


def sorted_samples(grid: Grid, cells: Integers, coverage: Coverage) -> Samples:
    """Return the cells that are not empty, in the order of their keys."""
    filled = np.flatnonzero(coverage.any(axis=(1, 2, 3)))
    order = filled[np.argsort(grid.key(cells[filled]))]
    return Samples(cells[order], coverage[order])
