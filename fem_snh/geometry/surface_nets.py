"""The surface of a shape as triangles, from its signed distance on a regular grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fem_snh.arrays import Array
from fem_snh.errors import BadInput, bad_value
from fem_snh.geometry.shapes.shape import Shape

Integers = npt.NDArray[np.int64]
Triangles = npt.NDArray[np.int32]

#: Largest number of cells in a grid: an array of one double for each cell takes 0.4 GB.
_MAX_CELLS = 50_000_000
#: Fraction of a cell by which a body may exceed a whole number of cells: rounding error, also of
#: single precision in STL files.
_ROUNDING = 1e-6
#: Corners of a cell in dolfinx's order, (8, 3).
CORNERS = np.array([[v & 1, v >> 1 & 1, v >> 2] for v in range(8)])
#: Distance, in edges of a cube, below the surface up to which a grid point counts as outside:
#: rounding error. An edge cut by a face of a box on the side of the grid then has all four cubes.
_ON_SURFACE = 1e-9
#: Newton steps that move points onto the surface; each squares the error.
_STEPS = 2
#: The edges of a cube as pairs of corners: four along x, along y, along z.
_EDGES = np.array([(v, v | 1 << a) for a in range(3) for v in range(8) if not v >> a & 1])


@dataclass(frozen=True)
class Grid:
    """Cubic cells of equal size in a box, numbered by (i, j, k) from the box's lowest corner.

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
        """Return the smallest grid that contains a box and has the same centre.

        Parameters
        ----------
        bounds : (2, 3) array
            Lowest and highest coordinates of the box [length].
        size : float
            The edge of a cube [length].
        key : str
            The name of ``size`` in messages.

        Raises
        ------
        BadInput
            For an infinite box, cubes not smaller than the box, or more than 50 million cubes.
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
        """Return a unique number for each of the cells (..., 3), ascending with (i, j, k).

        Cells may be outside of the grid by one cell.
        """
        _, ny, nz = self.shape + 2
        i, j, k = np.moveaxis(cells + 1, -1, 0)
        return (i * ny + j) * nz + k

    def rows(self, cells: Integers, wanted: Integers) -> tuple[Integers, Integers]:
        """Return which of ``wanted`` (n, 3) are among ``cells`` (m, 3), and their rows there.

        ``cells`` are sorted by `key`; the results are indices (k,) into both arrays.
        """
        keys, key = self.key(cells), self.key(wanted)
        at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        found = np.flatnonzero(keys[at] == key)
        return found, at[found]

    def centres(self, cells: Integers) -> Array:
        """Return the centres (n, 3) [length] of cells (n, 3)."""
        return self.origin + self.size * (cells + 0.5)


def cells_of_box(low: Integers, high: Integers) -> Integers:
    """Return all (i, j, k) with low <= (i, j, k) < high, (n, 3); k varies fastest."""
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _loops() -> Integers:
    """Return the number of the surface's loop that cuts each edge of a cube, (256, 12).

    The row of a cube is the sum of 2^v over its corners v that are inside; -1: the edge is not cut.
    A loop has the edges that the surface connects on faces of the cube. On a face with only two
    opposite corners inside, the surface goes around each of them, in both cubes alike.
    """
    table = np.full((256, 12), -1, dtype=np.int64)
    faces = [{v for v in range(8) if v >> a & 1 == side} for a in range(3) for side in (0, 1)]
    for case in range(256):
        inside = {v for v in range(8) if case >> v & 1}
        cut = [e for e, (v, w) in enumerate(_EDGES) if (v in inside) != (w in inside)]
        loop = {e: e for e in cut}
        for face in faces:
            on_face = [e for e in cut if face.issuperset(_EDGES[e].tolist())]
            groups = [on_face]
            if len(on_face) == 4:
                groups = [[e for e in on_face if v in _EDGES[e]] for v in face & inside]
            for first, *others in filter(None, groups):
                for e in others:
                    old = loop[e]
                    loop = {k: loop[first] if m == old else m for k, m in loop.items()}
        for number, name in enumerate(dict.fromkeys(loop.values())):
            table[case, [e for e, m in loop.items() if m == name]] = number
    return table


def surface_on(shape: Shape, grid: Grid) -> tuple[Array, Triangles]:
    """Return points (n, 3) [m] and triangles (m, 3) of a shape's surface in a whole grid.

    See `triangulate`, with one cube for each cell that the surface may cut.
    """
    cells = cells_of_box(np.zeros(3, np.int64), grid.shape)
    near = np.abs(shape.distance(grid.centres(cells))) < grid.size * np.sqrt(0.75)
    return triangulate(shape, grid, cells[near], 1)


def triangulate(
    shape: Shape, grid: Grid, cells: Integers, divisions: int
) -> tuple[Array, Triangles]:
    """Return points (n, 3) and triangles (m, 3) of a shape's surface, with outward normals.

    Each cell of the grid is divided into cubes. A cube has a point for each loop of the surface in
    it. The four points around each edge that the surface cuts form two triangles. So the surface is
    closed, and parts of the surface that pass through one cube do not touch.

    Parameters
    ----------
    shape : Shape
        The solid.
    grid : Grid
        The grid.
    cells : (k, 3) int array
        The cells of the grid that the surface may pass through.
    divisions : int
        Number of cubes along an edge of a cell.

    Raises
    ------
    BadInput
        If no cube has corners on both sides of the surface.

    References
    ----------
    Gibson 1998, Constrained elastic surface nets; Nielson 2004, Dual marching cubes.
    """
    edge = grid.size / divisions
    within = cells_of_box(np.zeros(3, np.int64), np.full(3, divisions))
    cubes: Integers = (divisions * cells[:, None] + within).reshape(-1, 3)
    fine = Grid(grid.origin, edge, divisions * grid.shape)
    grid_points = (cubes[:, None] + CORNERS).reshape(-1, 3)
    corner: Integers
    _, first, corner = np.unique(fine.key(grid_points), return_index=True, return_inverse=True)
    grid_points = grid_points[first]
    distance = shape.distance(grid.origin + edge * grid_points)
    corner = corner.reshape(-1, 8)
    case = (distance[corner] < -_ON_SURFACE * edge) @ (1 << np.arange(8))
    cut = np.flatnonzero((case > 0) & (case < 255))
    if not len(cut):
        raise bad_value("skin", divisions, "a larger number: the body is thinner than its cubes")
    cubes, corner, loops = cubes[cut], corner[cut], _loops()[case[cut]]
    order = np.argsort(fine.key(cubes))
    cubes, corner, loops = cubes[order], corner[order], loops[order]

    number = np.concatenate([[0], np.cumsum(loops.max(axis=1) + 1)])
    vertex = np.where(loops < 0, -1, number[:-1, None] + loops)  # of each edge of each cube
    a, b = np.moveaxis(distance[corner][:, _EDGES], 2, 0)
    t = np.divide(a, a - b, out=np.zeros_like(a), where=loops >= 0)
    start, end = np.moveaxis((cubes[:, None] + CORNERS)[:, _EDGES], 2, 0)
    crossing = start + t[:, :, None] * (end - start)
    on = vertex >= 0
    sums = [np.bincount(vertex[on], weights=crossing[on][:, i]) for i in range(3)]
    points = np.stack(sums, axis=1) / np.bincount(vertex[on])[:, None]
    home = np.repeat(cubes, np.diff(number), axis=0)
    x = _on_surface(shape, grid.origin + edge * points, grid.origin + edge * home, edge)
    return x, _triangles(fine, cubes, vertex, distance[corner] < -_ON_SURFACE * edge, x)


def _on_surface(shape: Shape, x: Array, low: Array, edge: float) -> Array:
    """Return points x (n, 3), moved along the gradient to the surface within their cubes.

    ``low`` (n, 3) are the cubes' lowest corners, and ``edge`` is the cubes' edge.
    """
    for _ in range(_STEPS):
        d, g, _ = shape.evaluate(x)
        square = np.einsum("ni,ni->n", g, g)
        step = np.divide(d, square, out=np.zeros_like(d), where=square > 0)
        x = np.clip(x - step[:, None] * g, low, low + edge)
    return x


def _triangles(
    grid: Grid, cubes: Integers, vertex: Integers, inside: npt.NDArray[np.bool_], x: Array
) -> Triangles:
    """Return the two triangles of each cut edge of the grid, from the points x of its four cubes.

    ``cubes`` (n, 3) are sorted by `Grid.key`; ``vertex`` (n, 12) is the point of each edge of a
    cube, or -1, and ``inside`` (n, 8) whether each corner is in the shape.
    """
    keys, found = grid.key(cubes), []
    for axis in range(3):
        b, c = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        e = 4 * axis  # the edge from corner 0: the cube is the highest of the four around it
        mine = np.flatnonzero(vertex[:, e] >= 0)
        ring = []
        for step in (b + c, c, 0 * b, b):
            row = np.searchsorted(keys, grid.key(cubes[mine] - step))
            v = int(step @ np.array([1, 2, 4]))
            local = e + int(np.flatnonzero(_EDGES[e : e + 4, 0] == v)[0])
            ring.append(vertex[row, local])
        quads = np.stack(ring, axis=1)
        upward = inside[mine, 0]
        quads[~upward] = quads[~upward, ::-1]
        found.append(quads)
    p, q, r, s = np.concatenate(found).T
    short = np.linalg.norm(x[p] - x[r], axis=1) <= np.linalg.norm(x[q] - x[s], axis=1)
    first = np.where(short[:, None], np.stack([p, q, r], 1), np.stack([p, q, s], 1))
    second = np.where(short[:, None], np.stack([p, r, s], 1), np.stack([q, r, s], 1))
    return np.concatenate([first, second]).astype(np.int32)
