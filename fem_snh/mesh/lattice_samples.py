"""How much of each cell of a grid a solid fills: a shape, by samples; a closed surface, exactly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.geometry.shapes import ClosedSurface, Shape
from fem_snh.geometry.shapes.shape import Array
from fem_snh.geometry.surface_nets import Grid, Integers, Triangles, cells_of_box

Coverage = npt.NDArray[np.float32]

#: Edge, in cells, of the blocks of cells that are left out together if they are outside.
_BLOCK = 4
#: Cells whose samples are evaluated together, which bounds the memory.
_CELLS = 20_000
#: Pairs of a triangle and a line that are tested together, which bounds the memory.
_PAIRS = 2_000_000
#: Part of a cube by which a length inside may differ from all of it: the digits of single
#: precision in STL files, relative to a cube.
_ROUNDING = 1e-4


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
    for start in range(0, len(cut), _CELLS):
        some = cut[start : start + _CELLS]
        corners = grid.origin + grid.size * cells[some]
        d = shape.distance((corners[:, None] + offsets).reshape(-1, 3))
        coverage[some] = np.clip(0.5 - d / edge, 0, 1).reshape(-1, *[samples] * 3)
    return sorted_samples(grid, cells, coverage), cells[cut]


def sorted_samples(grid: Grid, cells: Integers, coverage: Coverage) -> Samples:
    """Return the cells that are not empty, in the order of their keys."""
    filled = np.flatnonzero(coverage.any(axis=(1, 2, 3)))
    order = filled[np.argsort(grid.key(cells[filled]))]
    return Samples(cells[order], coverage[order])


def sample_surface(surface: ClosedSurface, grid: Grid, samples: int) -> Samples:
    """Return how much of each cell a closed surface encloses.

    Lines along z pass through the centres of the cubes. Between its crossings with the surface a
    line is inside where the triangles it has passed, counted by the sign of their normals, do not
    cancel (the winding number). A cube counts by the part of its line that is inside: lengths
    along z are exact, and x and y are sampled by the midpoint rule.

    Parameters
    ----------
    surface : ClosedSurface
        The surface.
    grid : Grid
        The cells.
    samples : int
        Cubes along an edge of a cell.
    """
    line, z, sign = _crossings(surface, grid, samples)
    order = np.lexsort((z, line))
    line, z, sign = line[order], z[order], sign[order]
    ny, nz = (int(n) * samples for n in grid.shape[1:])
    found_cells, found = [], []
    for i in range(int(grid.shape[0])):  # one layer of cells at a time
        own = slice(*np.searchsorted(line, [i * samples * ny, (i + 1) * samples * ny]))
        if own.start == own.stop:
            continue
        length = _inside(line[own] - i * samples * ny, z[own], sign[own], samples * ny, nz)
        blocks = length.reshape(samples, ny // samples, samples, nz // samples, samples)
        blocks = blocks.transpose(1, 3, 0, 2, 4)
        j, k = np.nonzero(blocks.any(axis=(2, 3, 4)))
        found_cells.append(np.stack([np.full(len(j), i), j, k], axis=1))
        found.append(blocks[j, k].astype(np.float32))
    return sorted_samples(grid, np.concatenate(found_cells), np.concatenate(found))


def _inside(line: Integers, z: Array, sign: Integers, lines: int, cubes: int) -> Array:
    """Return the part inside of each cube of each line, (lines, cubes).

    ``z`` are the crossings in cubes, sorted along each line.
    """
    depth = np.cumsum(sign)  # it is zero at the end of each line: the surface is closed
    inside = depth != 0
    start, end = z[:-1][inside[:-1]], z[1:][inside[:-1]]
    row = line[:-1][inside[:-1]]
    # The length inside below z = k is the sum of max(k - start, 0) - max(k - end, 0), which is
    # linear between cubes: differences of second order at the cubes of the ends.
    slope = np.zeros((lines, cubes + 2))
    for at, weight in ((start, 1.0), (end, -1.0)):
        k = np.clip(at.astype(np.int64), 0, cubes)
        rest = np.clip(k + 1 - at, 0.0, 1.0)  # of the cube beyond the end
        np.add.at(slope, (row, k), weight * rest)
        np.add.at(slope, (row, k + 1), weight * (1 - rest))
    length = np.clip(np.cumsum(slope, axis=1)[:, :cubes], 0.0, 1.0)
    length[length < _ROUNDING] = 0.0
    length[length > 1 - _ROUNDING] = 1.0
    return length


def _crossings(
    surface: ClosedSurface, grid: Grid, samples: int
) -> tuple[Integers, Array, Integers]:
    """Return the crossings of lines and triangles: line, height in cubes, and 1 where it enters.

    A line that passes through an edge meets exactly one of the two triangles on both sides of its
    projection: the side of the edge is decided by the same arithmetic for both.
    """
    edge = grid.size / samples
    x = (surface.points - grid.origin) / edge
    lines = grid.shape[:2] * samples
    corners = x[surface.triangles]
    low = np.clip(np.ceil(corners[:, :, :2].min(axis=1) - 0.5).astype(np.int64), 0, lines)
    high = np.clip(np.floor(corners[:, :, :2].max(axis=1) - 0.5).astype(np.int64) + 1, 0, lines)
    size = np.maximum(high - low, 0)
    count = size.prod(axis=1)
    ends = np.cumsum(count)
    found: list[tuple[Integers, Array, Integers]] = []
    first = 0
    while first < len(count):
        before = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, before + _PAIRS, side="right")), first + 1)
        t = np.repeat(np.arange(first, last), count[first:last])
        number = np.arange(len(t)) - (ends[t] - count[t] - before)
        i = low[t, 0] + number // np.maximum(size[t, 1], 1)
        j = low[t, 1] + number % np.maximum(size[t, 1], 1)
        found.append(_cross(x, surface.triangles[t], i, j, int(lines[1])))
        first = last
    line, z, sign = (np.concatenate([part[k] for part in found]) for k in range(3))
    return line, z, sign


def _cross(
    x: Array, triangles: Integers, i: Integers, j: Integers, lines: int
) -> tuple[Integers, Array, Integers]:
    """Return which pairs of a triangle and the line (i, j) cross, where, and in which sense."""
    px, py = i + 0.5, j + 0.5
    areas, sides = [], []
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        first, second = np.minimum(a, b), np.maximum(a, b)
        dx, dy = (x[second] - x[first])[:, :2].T
        area = dx * (py - x[first, 1]) - dy * (px - x[first, 0])
        sides.append((area >= 0) == (a < b))
        areas.append(np.where(a < b, area, -area))
    left = sides[0] & sides[1] & sides[2]
    right = ~(sides[0] | sides[1] | sides[2])
    hit = np.flatnonzero(left | right)
    weights = np.stack([areas[1][hit], areas[2][hit], areas[0][hit]], axis=1)
    total = weights.sum(axis=1)
    z = np.einsum("nk,nk->n", weights, x[triangles[hit], 2])
    height = np.divide(z, total, out=x[triangles[hit], 2].mean(axis=1), where=total != 0)
    # Seen from above, a triangle whose normal points up turns left: there the line leaves.
    return i[hit] * lines + j[hit], height, np.where(left[hit], -1, 1)


def refine(points: Array, triangles: Integers, longest: float) -> tuple[Array, Triangles]:
    """Return a surface whose edges are not longer than a length; its shape is the same.

    A triangle follows the deformation of a lattice only as finely as its corners do. Long edges
    are halved on both of their sides, so that a closed surface remains closed.

    Parameters
    ----------
    points, triangles : (n, 3) array, (m, 3) int array
        The surface.
    longest : float
        The length.
    """
    triangles = np.asarray(triangles, dtype=np.int64)
    while True:
        sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)  # (m, 3, 2)
        length = np.linalg.norm(points[sides[..., 0]] - points[sides[..., 1]], axis=2)
        edges, number = np.unique(
            np.sort(sides, axis=2)[length > longest], axis=0, return_inverse=True
        )
        if not len(edges):
            return points, triangles.astype(np.int32)
        middle = np.full(triangles.shape, -1)
        middle[length > longest] = len(points) + number.ravel()
        points = np.concatenate([points, points[edges].mean(axis=1)])
        triangles = _divided(triangles, middle)


def _divided(triangles: Integers, middle: Integers) -> Integers:
    """Return the triangles, divided at the midpoints (m, 3) of their edges; -1 for none."""
    count = (middle >= 0).sum(axis=1)
    found = [triangles[count == 0]]
    # Turned so that the edge that is divided alone, or not at all, comes first.
    for turn in range(3):
        a, b, c = np.roll(triangles, -turn, axis=1).T
        ab, bc, ca = np.roll(middle, -turn, axis=1).T
        one = (count == 1) & (ab >= 0)
        found += [np.stack([a, ab, c], 1)[one], np.stack([ab, b, c], 1)[one]]
        two = (count == 2) & (ab < 0)
        parts = ([a, b, bc], [a, bc, ca], [ca, bc, c])
        found += [np.stack(part, axis=1)[two] for part in parts]
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    all_three = ([a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca])
    found += [np.stack(part, axis=1)[count == 3] for part in all_three]
    return np.concatenate(found)
