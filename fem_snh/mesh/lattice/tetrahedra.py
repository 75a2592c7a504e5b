"""Tetrahedra that fill a body: a shape, or a closed surface."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_matrix

from fem_snh.geometry.shapes import ClosedSurface, Shape
from fem_snh.mesh.gmsh_input import MeshData, fill
from fem_snh.mesh.lattice.grid import Array, Grid, cells_of_box
from fem_snh.mesh.lattice.surface_nets import Triangles, triangulate
from fem_snh.mesh.mesh import Mesh, distribute

#: Sweeps of smoothing, after which triangles hardly change: the worst of a club of a capsule and a
#: ball goes from a quality of 1e-8 to 0.27, that of the tetrahedra from 1e-6 to 0.19.
_SWEEPS = 5
#: Newton steps back to the surface after each sweep, whose error they square.
_STEPS = 3


def create_tetrahedra(comm: MPI.Comm, body: Callable[[], Shape], size: float) -> Mesh:
    """Fill a body with tetrahedra by gmsh. Collective.

    The surface of a shape is triangulated first, with edges of about the given length; that of a
    file is taken as it is, so the quality of its triangles bounds that of the tetrahedra. The
    physical groups are ``body``, all cells, and ``boundary``, all facets of the boundary.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    body : callable
        Returns the body's shape. It is called on rank 0 only.
    size : float
        Length of the edges [length].

    Raises
    ------
    BadInput
        On every rank, for a body without bounds, a size that does not fit it, and if gmsh fails.
    """
    return distribute(comm, "mesh.surface", lambda: tetrahedra(body(), size))


def tetrahedra(shape: Shape, size: float) -> MeshData:
    """Return the mesh of a body; see `create_tetrahedra`. Not collective."""
    grid = Grid.around(shape.bounds, size, "size")
    if isinstance(shape, ClosedSurface):
        return fill(shape.points, shape.triangles, size)
    cells = cells_of_box(np.zeros(3, np.int64), grid.shape)
    near = np.abs(shape.distance(grid.centres(cells))) < grid.size * np.sqrt(0.75)
    points, triangles = triangulate(shape, grid, cells[near], 1)
    return fill(_smoothed(shape, points, triangles), triangles, size)


def _smoothed(shape: Shape, x: Array, triangles: Triangles) -> Array:
    """Return the points, moved to the means of their neighbours and back to the surface."""
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ones = np.ones(len(edges))
    neighbours = coo_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(len(x), len(x))).tocsr()
    count = np.asarray(neighbours.sum(axis=1))
    for _ in range(_SWEEPS):
        x = neighbours @ x / count
        for _ in range(_STEPS):
            d, g, _ = shape.evaluate(x)
            square = np.einsum("ni,ni->n", g, g)
            x = x - np.divide(d, square, out=np.zeros_like(d), where=square > 0)[:, None] * g
    return x
