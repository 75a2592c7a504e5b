"""Finer triangles and tetrahedra: bisection of a mesh with its groups, and sizes for a new one.

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
from fem_snh.mesh.gmsh_model import MeshData, SizeField

Array = np.ndarray

#: Cells at which bisection of the mesh of a run ends.
MOST_CELLS = 20_000_000
#: A cell is bisected if its volume is larger than the target times this: halves are then as much
#: too small as the whole was too large.
_TOLERANCE = 2**0.5
#: Rounds of bisection: three halve the edges.
_MAX_ROUNDS = 60
#: Bisection makes more cells than were wanted, as it leaves no hanging nodes: the wanted number is
#: then reduced, down to this factor, until at most so many times as many are made.
_TRIES, _LEAST_GROWTH, _MORE = 4, 1.2, 1.2
#: Volume of a regular simplex with edges of length 1, by its dimension.
_REGULAR = {2: 3**0.5 / 4, 3: 2**0.5 / 12}
#: The largest change of the size over the distance: neighbours differ by about a third.
_GRADIENT = 0.35
#: Edges of gmsh's cells over the size that was asked for, by the dimension.
_LONGER = {2: 1.0, 3: 1.2}


class MarkedEdges(NamedTuple):
    """Edges to bisect: sorted keys, ranks by length, and the numbers of their midpoints."""

    keys: Array
    ranks: Array
    midpoints: Array


def bisect_times(
    data: MeshData, target: Callable[[float], Array], wanted: float, max_cells: int
) -> MeshData:
    """Return the mesh with about so many times as many cells, and at least some more. On rank 0.

    Parameters
    ----------
    data : MeshData
        As for `bisect`.
    target : callable
        Returns the volumes of the cells by the factor of their number.
    wanted : float
        The factor, above 1.
    max_cells : int
        As for `bisect`.
    """
    growth, refined = wanted, data
    for _ in range(_TRIES):
        tried = bisect(data, target(growth), max_cells)
        found = len(tried.cells) / len(data.cells)
        if found == 1:  # all cells are to be a little smaller: none, or all are bisected
            if refined is not data:
                break
            growth *= _TOLERANCE
            continue
        refined = tried
        if found <= _MORE * wanted or growth == _LEAST_GROWTH:
            break
        growth = max(_LEAST_GROWTH, growth * wanted / found)
    return refined


def bisect(data: MeshData, volumes: Array, max_cells: int) -> MeshData:
    """Return the mesh with cells of about these volumes, or smaller ones. On rank 0.

    Parameters
    ----------
    data : MeshData
        A mesh of tetrahedra or triangles, in dolfinx's order of nodes.
    volumes : (cells,) array
        The largest volume wanted in each cell [length^dim].
    max_cells : int
        No further round is made with so many cells.

    Returns
    -------
    MeshData
        The mesh. Cells of degree 2 are on the curved faces of those that they are part of.
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
        marked = simplex_volumes(x[cells]) > _TOLERANCE * volumes[roots]
        if not marked.any() or len(cells) >= max_cells:
            break
        found, places = _marked_edges(cells, x, marked)
        owner, edge = np.divmod(places, len(pairs))
        ends = barycentric[owner[:, None], pairs[edge]]
        x = np.concatenate([x, _points(data, roots[owner], ends.mean(axis=1))])
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
        cells, x = _with_midpoints(data, cells, x, roots, barycentric)
    return data._replace(cells=cells, x=x, groups=groups)


def edge_keys(pairs: Array) -> Array:
    """Return a number for each pair of vertices (..., 2), whatever their order."""
    low, high = np.sort(pairs, axis=-1).T
    return np.asarray((low.astype(np.int64) << 32 | high).T)


def _marked_edges(cells: Array, x: Array, marked: Array) -> tuple[MarkedEdges, Array]:
    """Return the edges to bisect, and for each its place in the edges of all cells, flattened."""
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
    """Return simplices without marked edges, the row of each one's origin, and coordinates."""
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


def _points(data: MeshData, roots: Array, barycentric: Array) -> Array:
    """Return points of cells of the original mesh from barycentric coordinates, (n, dim)."""
    basis = _dolfinx.tabulate_element(data.cell, data.degree, barycentric[:, 1:], 0)[0]
    return np.asarray(np.einsum("pk,pki->pi", basis, data.x[data.cells[roots]]))


def _with_midpoints(
    data: MeshData, cells: Array, x: Array, roots: Array, barycentric: Array
) -> tuple[Array, Array]:
    """Return cells of degree 2 and their nodes: the midpoints are on the original curved cells."""
    edges = _dolfinx.reference_edges(data.cell)
    keys = edge_keys(cells[:, edges])
    _, first, numbers = np.unique(keys, return_index=True, return_inverse=True)
    owner, edge = np.divmod(first, len(edges))
    middle = barycentric[owner[:, None], edges[edge]].mean(axis=1)
    nodes = np.concatenate([x, _points(data, roots[owner], middle)])
    return np.concatenate([cells, len(x) + numbers.reshape(keys.shape)], axis=1), nodes


def size_field(cells: Array, x: Array, volumes: Array) -> SizeField:
    """Return the sizes at the corners of cells in whose place are cells of other volumes.

    The sizes are graded. As grading makes cells smaller, all are then larger by a factor with which
    as many cells are expected as the volumes ask for.

    Parameters
    ----------
    cells : (cells, corners) array
        The corners of triangles or tetrahedra.
    x : (nodes, 2 or 3) array
        Coordinates [m].
    volumes : (cells,) array
        The volumes of cells that are wanted in the place of each [m^dim].
    """
    dim = x.shape[1]
    used, corners = np.unique(cells, return_inverse=True)
    corners, x = corners.reshape(cells.shape), x[used]
    own = simplex_volumes(x[corners])
    wanted = np.log(volumes / _REGULAR[dim]) / dim
    ends = corners.ravel()
    means = np.bincount(ends, np.repeat(wanted, dim + 1)) / np.bincount(ends)
    sizes = _graded(np.exp(means), corners, x)
    expected = (own / (_REGULAR[dim] * sizes[corners].mean(axis=1) ** dim)).sum()
    sizes *= (expected / (own / volumes).sum()) ** (1 / dim) / _LONGER[dim]
    points = np.zeros((len(x), 3))
    points[:, :dim] = x
    return SizeField(points[corners], sizes[corners])


def _graded(sizes: Array, cells: Array, x: Array) -> Array:
    """Return the largest sizes, none above those given, whose change along edges is limited."""
    pairs = simplex_edges(cells.shape[1])
    edges = np.unique(np.sort(cells[:, pairs].reshape(-1, 2), axis=1), axis=0)
    rise = _GRADIENT * np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
    sizes = sizes.copy()
    while True:
        before = sizes.copy()
        for here, there in (edges.T, edges.T[::-1]):
            np.minimum.at(sizes, here, sizes[there] + rise)
        if np.array_equal(sizes, before):
            return sizes


def simplex_edges(corners: int) -> Array:
    """Return the edges of a simplex with so many corners, (edges, 2)."""
    return np.array(list(combinations(range(corners), 2)))


def simplex_volumes(x: Array) -> Array:
    """Return the volumes of simplices from their corners, (cells, dim + 1, dim) [m^dim]."""
    dim = x.shape[2]
    return np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / factorial(dim)
