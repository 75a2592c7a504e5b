"""Which cells of a body are close to which triangles of its surface, by the vertices they share."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fem_snh import _dolfinx
from fem_snh.contact.surfaces.embedded_surface import EmbeddedSurface

Array = npt.NDArray[Any]

#: Value of a shape function of degree 1 below which its vertex is not on the entity of a node.
_ZERO = 1e-9
#: Comparisons of vertices at a time, which bounds the memory.
_BATCH = 10_000_000


class Neighbourhood:
    """The vertices of the cells, and of the facets or cells that carry a surface. Collective.

    Vertices are numbered as global nodes of the displacement's space. A node of degree 2 is on an
    edge, a facet or a cell, and stands for the vertices of that.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    surface : EmbeddedSurface
        The surface.

    Attributes
    ----------
    cells : (cells, vertices) int64
        The vertices of each cell that this rank owns.
    triangles : (m, q) int64
        The vertices that carry each triangle, padded with -1; the same on all ranks.
    """

    def __init__(self, V: Any, surface: EmbeddedSurface) -> None:
        kind, degree = _dolfinx.cell_name(V.mesh), _dolfinx.degree(V)
        nodes = _dolfinx.local_to_global(V)[_dolfinx.node_dofs(V)]
        self.cells = nodes[:, : len(_dolfinx.reference_corners(kind))]
        table = _dolfinx.tabulate_element(kind, 1, _dolfinx.reference_nodes(kind, degree), 0)[0]
        wanted = surface.support.nodes
        found = np.full((len(wanted), len(table[0])), -1)
        for number, values in enumerate(table):
            vertices = np.flatnonzero(np.abs(values) > _ZERO)
            chosen = np.isin(nodes[:, number], wanted)
            rows = np.searchsorted(wanted, nodes[chosen, number])
            # In the order of their numbers, which is the same in all cells.
            found[rows, : len(vertices)] = np.sort(self.cells[chosen][:, vertices], axis=1)
        self._points = np.max(V.mesh.comm.allgather(found), axis=0)[surface.columns]
        self.triangles = self.around(surface.triangles)

    def around(self, points: Array, used: Array | None = None) -> Array:
        """Return the vertices that carry points of the surface, (n, q) int64, padded with -1.

        ``points`` (n, k) are the surface's points of each of n things, of which those ``used``
        (n, k) bool count; default: all.
        """
        vertices = self._points[points]
        if used is not None:
            vertices = np.where(used[..., None, None], vertices, -1)
        return _unique_rows(vertices.reshape(len(points), -1))

    def share(self, triangle: Array, cell: Array) -> Array:
        """Return which of the triangles and cells, by number (n,), have a common vertex."""
        return intersect(self.triangles[triangle], self.cells[cell])


def body_numbers(V: Any) -> Array:
    """Return a number for each local node that is the same for all of a body. Collective.

    Two bodies of a mesh have no common node.
    """
    comm, nodes = V.mesh.comm, _dolfinx.node_dofs(V)
    size, numbers = sum(_dolfinx.num_nodes(V)), _dolfinx.local_to_global(V)
    first = np.repeat(nodes[:, :1], nodes.shape[1], axis=1).ravel()
    count, label = _components(first, nodes.ravel(), size)
    label = label + (comm.exscan(count) or 0)
    # A node of several ranks joins their labels.
    ghosts = numbers[_dolfinx.num_nodes(V)[0] :]
    shared = np.unique(np.concatenate(comm.allgather(ghosts)))
    mine = np.isin(numbers, shared)
    pairs = np.concatenate(comm.allgather(np.stack([numbers[mine], label[mine]], axis=1)))
    total = comm.allreduce(count)
    columns = total + np.searchsorted(shared, pairs[:, 0])
    return np.asarray(_components(pairs[:, 1], columns, total + len(shared))[1][label])


def _components(first: Array, second: Array, size: int) -> tuple[int, Array]:
    """Return the number of connected components of a graph, and that of each of its nodes."""
    graph = coo_matrix((np.ones(len(first), np.int8), (first, second)), shape=(size, size))
    count, label = connected_components(graph, directed=False)
    return int(count), label


def _unique_rows(values: Array) -> Array:
    """Return rows with each number once, without -1, padded with -1."""
    values = -np.sort(-values, axis=1)
    repeated = np.zeros(values.shape, bool)
    repeated[:, 1:] = values[:, 1:] == values[:, :-1]
    values = -np.sort(-np.where(repeated, -1, values), axis=1)
    return np.asarray(values[:, : (values >= 0).sum(axis=1).max(initial=1)])


def intersect(a: Array, b: Array) -> Array:
    """Return which rows of non-negative numbers, padded with -1, have a common one, (n,) bool."""
    found = np.zeros(len(a), bool)
    step = max(1, _BATCH // max(1, a.shape[1] * b.shape[1]))
    for start in range(0, len(a), step):
        some = slice(start, start + step)
        equal = (a[some, :, None] == b[some, None, :]) & (a[some, :, None] >= 0)
        found[some] = equal.any(axis=(1, 2))
    return found
