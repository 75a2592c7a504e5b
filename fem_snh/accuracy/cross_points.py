r"""Find where stiff parts of a body meet at a point, or along an edge, alone.

Around a point at which four right-angled sectors of two stiffnesses, of ratio k, alternate, the
solution of the scalar problem is :math:`r^\lambda` with :math:`\lambda = (4/\pi) \arctan
k^{-1/2}` (Kellogg 1975): any mesh of cells of a size h has errors as :math:`h^{2\lambda}`, of which
a lifted element, and each finer level, finds a small part. Where the stiffness is quasi-monotone
around each point (Petzoldt 2001), with one largest value, there is no such exponent.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fem_snh import _dolfinx
from fem_snh.accuracy.goal_errors import NoEstimateOnAnyMesh
from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]

#: The ratio of stiffnesses at which the exponent is 1/2, as at a crack, for which estimates are
#: made: tan(pi/8)^-2.
MOST = (1 + sqrt(2)) ** 2
#: Decimal places of a position in a message: a coordinate of rounding is shown as zero.
_DIGITS = 12


def check_cross_points(problem: Problem) -> None:
    """Raise NoEstimate for a body whose stiff parts meet at points, or edges, alone. Collective."""
    stiffness = [float(region.material.lame[0]) for region in problem.regions]
    if len(stiffness) < 2 or max(stiffness) <= MOST * min(stiffness):
        return
    comm, domain = problem.comm, problem.domain
    vertices = _dolfinx.cell_vertices(domain)
    of_cells = np.zeros(len(vertices))
    for region, value in zip(problem.regions, stiffness, strict=True):
        of_cells[region.cells] = value
    parts = comm.gather((vertices, of_cells))
    found: Array = np.empty(0, np.int64)
    if parts:
        all_vertices, values = map(np.concatenate, zip(*parts, strict=True))
        found = cross_points(all_vertices, values, _dolfinx.cell_name(domain))
    found = comm.bcast(found)
    if not len(found):
        return
    cells, corners = np.nonzero(vertices == found[0])
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)[cells, corners]]
    at = next(part[0] for part in comm.allgather(x.tolist()) if part)
    where = ", ".join(
        f"{round(value, _DIGITS) + 0.0:.4g}" for value in at[: problem.kinematics.dim]
    )
    what = "at a point alone" if problem.kinematics.dim == 2 else "along an edge alone"
    raise NoEstimateOnAnyMesh(
        f"stiff parts meet {what}, at ({where}), between softer ones: errors decrease so slowly "
        "there on finer cells that an estimate finds a small part of them; let the parts share "
        "a surface, or leave a gap"
    )


def cross_points(cells: Array, stiffness: Array, kind: str) -> Array:
    """Return a vertex of each point, or edge, around which the stiffness has several maxima.

    Parameters
    ----------
    cells : (n, corners) int array
        The vertices of cells.
    stiffness : (n,) array
        Their stiffness; ratios up to `MOST` do not count.
    kind : str
        The kind of cell, "quadrilateral".

    Returns
    -------
    (points,) array
        Vertices, sorted.
    """
    least, most = np.full(cells.max() + 1, np.inf), np.zeros(cells.max() + 1)
    np.minimum.at(least, cells, stiffness[:, None])
    np.maximum.at(most, cells, stiffness[:, None])
    near = (most > MOST * least)[cells].any(axis=1)
    cells, stiffness = cells[near], stiffness[near]
    facets = _dolfinx.reference_facets(kind)
    is_plane = len(facets[0]) == 2
    ridges = np.arange(cells.shape[1])[:, None] if is_plane else _dolfinx.reference_edges(kind)
    # The parts of cells at a ridge are nodes of a graph, and joined by facets with that ridge.
    nodes = np.arange(cells.size // cells.shape[1] * len(ridges)).reshape(-1, len(ridges))
    rows = []
    for facet in facets:
        for number, ridge in enumerate(ridges):
            if np.isin(ridge, facet).all():
                corners = np.sort(cells[:, facet], axis=1), np.sort(cells[:, ridge], axis=1)
                rows.append(np.hstack([*corners, nodes[:, [number]]]))
    joined = np.concatenate(rows)
    joined = joined[np.lexsort(joined[:, :-1].T)]
    same = (joined[1:, :-1] == joined[:-1, :-1]).all(axis=1)
    pairs = np.column_stack([joined[:-1, -1][same], joined[1:, -1][same]])
    values = np.repeat(stiffness, len(ridges))
    star = _components(pairs, len(values))
    several: list[Array] = []
    for maximum in np.unique(stiffness):
        stiff = MOST * values >= maximum
        parts = _components(pairs[stiff[pairs].all(axis=1)], len(values))
        tops = np.flatnonzero(values >= maximum)
        unique = np.unique(np.column_stack([star[tops], parts[tops]]), axis=0)
        stars, counts = np.unique(unique[:, 0], return_counts=True)
        several.append(tops[np.isin(star[tops], stars[counts > 1])])
    found = np.unique(np.concatenate(several)) if several else np.empty(0, int)
    at = cells[:, ridges[:, 0]].ravel()[found]
    return np.unique(at)


def _components(pairs: Array, size: int) -> Array:
    """Return the number of the connected component of each node of a graph."""
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (size, size))
    numbers: Array = connected_components(graph, directed=False)[1]
    return numbers
