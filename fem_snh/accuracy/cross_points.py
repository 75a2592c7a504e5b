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
    facets = np.array(_dolfinx.reference_facets(kind))
    is_plane = facets.shape[1] == 2
    ridges = np.arange(cells.shape[1])[:, None] if is_plane else _dolfinx.reference_edges(kind)
    of_facet = np.array(
        [[i for i, ridge in enumerate(ridges) if np.isin(ridge, facet).all()] for facet in facets]
    )
    vertices, numbers = _numbers(cells[:, ridges])
    count = len(vertices)
    # Cells that share a facet are joined at its ridges.
    shared = _numbers(cells[:, facets])[1].ravel()
    order = np.argsort(shared, kind="stable")
    same = shared[order[1:]] == shared[order[:-1]]
    (one, facet), (other, _) = (divmod(side[same], len(facets)) for side in (order[:-1], order[1:]))
    joined = numbers[one[:, None], of_facet[facet]]

    def parts(kept: Array) -> Array:
        """Return into how many parts some cells fall at each ridge; 0 if they are all around."""
        both = kept[one] & kept[other]
        at, links = numbers[kept].ravel(), joined[both].ravel()
        return np.bincount(at, minlength=count) - np.bincount(links, minlength=count)

    most_parts = np.maximum(parts(np.ones(len(cells), bool)), 1)
    several = np.zeros(count, bool)
    for maximum in np.unique(stiffness):
        several |= parts(MOST * stiffness >= maximum) > most_parts
    return np.unique(vertices[several])


def _numbers(entities: Array) -> tuple[Array, Array]:
    """Return a vertex of each entity (cells, entities, vertices), and numbers of equal ones."""
    rows = np.sort(entities, axis=2).reshape(-1, entities.shape[2])
    unique, numbers = np.unique(rows, axis=0, return_inverse=True)
    return unique[:, 0], numbers.reshape(entities.shape[:2])
