"""Finer triangles and tetrahedra: bisection of a mesh with its groups, and sizes for a new mesh.

Cells are bisected at their longest edge (Rivara 1991). The marked edges of a face are bisected in
the order of their lengths in both of its cells, so the mesh has no hanging nodes. Only rank 0 has
the mesh; `fem_snh.mesh.mesh.distribute` distributes it.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from math import factorial
from typing import NamedTuple

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.mesh.gmsh_model import MeshData, SizeField

#: Number of cells at which bisection in a run stops.
MOST_CELLS = 20_000_000
#: A cell is bisected if its volume over the target is larger than this: halves are then too small
#: by at most the factor by which the cell was too large.
_TOLERANCE = 2**0.5
#: Largest number of rounds of bisection; three rounds halve the edges.
_MAX_ROUNDS = 60
#: Bisection makes more cells than wanted, as it leaves no hanging nodes. In at most _TRIES attempts
#: the factor is reduced, to at least _LEAST_GROWTH, until at most _MORE times the wanted number is
#: made.
_TRIES, _LEAST_GROWTH, _MORE = 4, 1.2, 1.2
#: Volume of a regular simplex with edges of length 1, by its dimension.
_REGULAR = {2: 3**0.5 / 4, 3: 2**0.5 / 12}
#: The largest change of cell size per distance: neighbours differ by about a third; and that of
#: sizes over the present ones along an edge, with which bisected cells are about as gradual.
_GRADIENT, _RISE = 0.35, 0.25
#: Edges of gmsh's cells over the requested size, by dimension.
_LONGER = {2: 1.0, 3: 1.2}


class MarkedEdges(NamedTuple):
    """Edges to bisect: sorted `edge_keys`, ranks by length, and midpoint nodes, (n,) each."""

    keys: Array
    ranks: Array
    midpoints: Array


def bisect_times(
    data: MeshData, target: Callable[[float], Array], wanted: float, max_cells: int
) -> tuple[MeshData, Array]:
    """Bisect cells until their number is about ``wanted`` times as large. On rank 0.

    Parameters
    ----------
    data : MeshData
        As for `bisect`.
    target : callable
        ``target(factor)`` returns the wanted sizes of `bisect` for ``factor`` times the cells.
    wanted : float
        The wanted factor, above 1.
    max_cells : int
        As for `bisect`.

    Returns
    -------
    MeshData, (cells,) array
        As `bisect` does.
    """
    growth, refined = wanted, (data, np.arange(len(data.cells)))
    for _ in range(_TRIES):
        tried = bisect(data, target(growth), max_cells)
        found = len(tried[1]) / len(data.cells)
        if found == 1:  # all cells are to be a little smaller: none, or all are bisected
            if refined[0] is not data:
                break
            growth *= _TOLERANCE
            continue
        refined = tried
        if found <= _MORE * wanted or growth == _LEAST_GROWTH:
            break
        growth = max(_LEAST_GROWTH, growth * wanted / found)
    return refined


def bisect(data: MeshData, sizes: Array, max_cells: int) -> tuple[MeshData, Array]:
    """Return the mesh with cells of about these sizes or smaller. On rank 0.

    Parameters
    ----------
    data : MeshData
        A mesh of tetrahedra or triangles, in dolfinx's order of nodes.
    sizes : (cells, corners) array
        The largest length of edges wanted at the corners of each cell; linear in it.
    max_cells : int
        No round starts with this number of cells or more.

    Returns
    -------
    MeshData
        The mesh. New nodes, also of degree 2, are on the original curved cells.
    (cells,) int array
        The original cell of which each is a part.
    """
    dim, pairs = data.x.shape[1], simplex_edges(data.x.shape[1] + 1)
    vertices, corners = np.unique(data.cells[:, : dim + 1], return_inverse=True)
    cells, x = corners.reshape(-1, dim + 1).astype(np.int64), data.x[vertices]
    parts = {
        i: np.searchsorted(vertices, group.entities)
        for i, group in enumerate(data.groups)
        if 0 < group.dim < dim
    }
    roots = np.arange(len(cells))
    barycentric = np.tile(np.eye(dim + 1), (len(cells), 1, 1))
    for _ in range(_MAX_ROUNDS):
        wanted = np.einsum("cik,ck->c", barycentric, sizes[roots]) / (dim + 1)
        marked = simplex_volumes(x[cells]) > _TOLERANCE * _REGULAR[dim] * wanted**dim
        if not marked.any() or len(cells) >= max_cells:
            break
        found, places = _marked_edges(cells, x, marked)
        owner, edge = np.divmod(places, len(pairs))
        ends = barycentric[owner[:, None], pairs[edge]]
        x = np.concatenate([x, _points(data, roots[owner], ends.mean(axis=1)[:, 1:])])
        cells, parents, barycentric = split(cells, found, barycentric)
        roots = roots[parents]
        parts = {i: split(simplices, found)[0] for i, simplices in parts.items()}
    used, numbers = np.unique(cells, return_inverse=True)
    assert len(used) == len(x)
    cells = numbers.reshape(-1, dim + 1)
    groups = []
    for i, group in enumerate(data.groups):
        if group.dim == dim:
            entities = np.flatnonzero(np.isin(roots, group.entities))
        else:
            entities = parts.get(i, np.searchsorted(vertices, group.entities))
        groups.append(group._replace(entities=entities))
    if data.degree == 2:
        cells, x = with_midpoints(data, data.cell, cells, x, roots, barycentric[..., 1:])
    return data._replace(cells=cells, x=x, groups=groups), roots


def edge_keys(pairs: Array) -> Array:
    """Return a unique number for each unordered pair of vertices (..., 2)."""
    low, high = np.sort(pairs, axis=-1).T
    return np.asarray((low.astype(np.int64) << 32 | high).T)


def _marked_edges(cells: Array, x: Array, marked: Array) -> tuple[MarkedEdges, Array]:
    """Return the edges to bisect, and the first index of each among all (cells * edges,)."""
    pairs = simplex_edges(cells.shape[1])
    keys = edge_keys(cells[:, pairs])
    unique, first, edges = np.unique(keys, return_index=True, return_inverse=True)
    edges = edges.reshape(keys.shape)
    ends = cells[:, pairs].reshape(-1, 2)[first]
    lengths = np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
    ranks = np.empty(len(unique), dtype=np.int64)
    ranks[np.lexsort((unique, np.round(np.log(lengths), 9)))] = np.arange(len(unique))
    longest = edges[np.arange(len(cells)), ranks[edges].argmax(axis=1)]
    chosen = np.zeros(len(unique), dtype=bool)
    chosen[longest[marked]] = True
    # A cell with a marked edge is bisected at its longest one first, which keeps angles large.
    while (lacking := chosen[edges].any(axis=1) & ~chosen[longest]).any():
        chosen[longest[lacking]] = True
    numbers = len(x) + np.arange(chosen.sum())
    return MarkedEdges(unique[chosen], ranks[chosen], numbers), first[chosen]


def split(
    simplices: Array, marked: MarkedEdges, barycentric: Array | None = None
) -> tuple[Array, Array, Array]:
    """Bisect simplices until none has a marked edge.

    Returns
    -------
    simplices : (n, corners) int
    origins : (n,) int
        The input row of the simplex of which each simplex is a part.
    barycentric : (n, corners, k)
        The coordinates of the corners in that simplex; k = 0 if not given.
    """
    size = simplices.shape[1]
    pairs = simplex_edges(size)
    origins = np.arange(len(simplices))
    attached = np.zeros((len(simplices), size, 0)) if barycentric is None else barycentric
    while len(simplices):
        keys = edge_keys(simplices[:, pairs])
        at = np.minimum(np.searchsorted(marked.keys, keys), len(marked.keys) - 1)
        ranks = np.where(marked.keys[at] == keys, marked.ranks[at], -1)
        split = ranks.max(axis=1) >= 0
        if not split.any():
            break
        edge = ranks[split].argmax(axis=1)
        rows = np.arange(len(edge))
        middle = marked.midpoints[at[split][rows, edge]]
        halves, positions = [simplices[~split]], [attached[~split]]
        means = attached[split][rows[:, None], pairs[edge]].mean(axis=1)
        for end in pairs[edge].T:
            half, position = simplices[split].copy(), attached[split].copy()
            half[rows, end], position[rows, end] = middle, means
            halves.append(half)
            positions.append(position)
        simplices, attached = np.concatenate(halves), np.concatenate(positions)
        origins = np.concatenate([origins[~split], origins[split], origins[split]])
    return simplices, origins, attached


def _points(data: MeshData, roots: Array, reference: Array) -> Array:
    """Return points (n, dim) of original cells ``roots`` (n,) from reference coordinates."""
    basis = _dolfinx.tabulate_element(data.cell, data.degree, reference, 0)[0]
    return np.asarray(np.einsum("pk,pki->pi", basis, data.x[data.cells[roots]]))


def with_midpoints(
    data: MeshData, cell: str, cells: Array, x: Array, roots: Array, reference: Array
) -> tuple[Array, Array]:
    """Return simplices of degree 2, whose midpoints are on original curved cells, and their nodes.

    Parameters
    ----------
    data : MeshData
        The original mesh.
    cell : {"triangle", "tetrahedron"}
        What the simplices are.
    cells, x : (n, corners), (vertices, dim) array
        The simplices, and the coordinates of their vertices.
    roots, reference : (n,), (n, corners, dim) array
        The original cell of which each is a part, and the reference coordinates there.
    """
    edges = _dolfinx.reference_edges(cell)
    keys = edge_keys(cells[:, edges])
    _, first, numbers = np.unique(keys, return_index=True, return_inverse=True)
    owner, edge = np.divmod(first, len(edges))
    middle = reference[owner[:, None], edges[edge]].mean(axis=1)
    nodes = np.concatenate([x, _points(data, roots[owner], middle)])
    return np.concatenate([cells, len(x) + numbers.reshape(keys.shape)], axis=1), nodes


class VertexSizes:
    """Sizes at the vertices of simplices: with them sizes change gradually, also in a cell.

    Parameters
    ----------
    cells : (cells, corners) array
        The corners of triangles or tetrahedra.
    x : (nodes, 2 or 3) array
        Coordinates [m].
    """

    def __init__(self, cells: Array, x: Array) -> None:
        used, corners = np.unique(cells, return_inverse=True)
        self._corners, self._x = corners.reshape(cells.shape), x[used]
        self._ends, self._dim = self._corners.ravel(), x.shape[1]
        pairs = self._corners[:, simplex_edges(self._dim + 1)].reshape(-1, 2)
        self._edges = np.unique(np.sort(pairs, axis=1), axis=0)
        self._own = simplex_volumes(self._x[self._corners])
        self._around = np.bincount(self._ends)

    def expected(self, volumes: Array) -> float:
        """Return the number of cells that are to have wanted volumes (cells,) [m^d]."""
        means = self._changes(volumes)[self._corners].mean(axis=1)
        return float((means**-self._dim).sum())

    def at_corners(self, volumes: Array) -> Array:
        """Return the sizes of `bisect`, from wanted volumes (cells,) [m^d].

        From a vertex around which cells are to become smaller on, sizes over those of the cells
        grow by ``_RISE`` along an edge, however thin the cells are.
        """
        rise = np.full(len(self._edges), _RISE)
        changes = _graded(self._changes(volumes), self._edges, rise)[self._corners]
        return np.asarray(edge_lengths(self._own, self._dim)[:, None] * changes)

    def _changes(self, volumes: Array) -> Array:
        """Return by which factors sizes at vertices change with wanted volumes (cells,)."""
        return self._means((volumes / self._own) ** (1 / self._dim))

    def _means(self, sizes: Array) -> Array:
        """Return the geometric means, at each vertex, of the sizes (cells,) of cells around it."""
        sums = np.bincount(self._ends, np.repeat(np.log(sizes), self._dim + 1))
        return np.exp(sums / self._around)

    def field(self, volumes: Array) -> SizeField:
        """Return the size field with which a new mesh has about the wanted volumes (cells,).

        The limited change of sizes makes cells smaller: all are then multiplied by one factor, so
        that the expected number of cells is the same.
        """
        wanted = self._means(edge_lengths(volumes, self._dim))
        lengths = np.linalg.norm(np.diff(self._x[self._edges], axis=1)[:, 0], axis=1)
        sizes, dim = _graded(wanted, self._edges, _GRADIENT * lengths), self._dim
        counts = (
            (self._own / of_vertices[self._corners].mean(axis=1) ** dim).sum()
            for of_vertices in (sizes, wanted)
        )
        sizes *= (next(counts) / next(counts)) ** (1 / dim) / _LONGER[dim]
        points = np.zeros((len(self._x), 3))
        points[:, :dim] = self._x
        return SizeField(points[self._corners], sizes[self._corners])


def _graded(sizes: Array, edges: Array, rise: Array) -> Array:
    """Return the largest values <= ``sizes`` that grow along edges by at most ``rise``."""
    sizes = sizes.copy()
    while True:
        before = sizes.copy()
        for here, there in (edges.T, edges.T[::-1]):
            np.minimum.at(sizes, here, sizes[there] + rise)
        if np.array_equal(sizes, before):
            return sizes


def simplex_edges(corners: int) -> Array:
    """Return the edges of a simplex with a number of corners, (edges, 2)."""
    return np.array(list(combinations(range(corners), 2)))


def edge_lengths(volumes: Array, dim: int) -> Array:
    """Return the lengths of the edges of regular simplices of some volumes [m^dim]."""
    return np.asarray((volumes / _REGULAR[dim]) ** (1 / dim))


def simplex_volumes(x: Array) -> Array:
    """Return the volumes [m^dim] of simplices with corners ``x`` (cells, dim + 1, dim)."""
    dim = x.shape[2]
    return np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / factorial(dim)
