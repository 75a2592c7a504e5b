"""The quadrature points at which a body is inverted, J <= 0."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fem_snh.assembly.ghosted_vectors import local_values
from fem_snh.assembly.point_volumes import cell_centres, point_volumes
from fem_snh.problem.problem import Problem


class InvertedPoints(NamedTuple):
    """The inverted points of a state, on all ranks.

    Attributes
    ----------
    points, cells : int
        Number of points with J <= 0, and of cells that have one.
    of : int
        Number of points.
    min_J : float
        The smallest J.
    position : list of float
        Centre of the cell that has it, in the reference configuration [m].
    material : int
        Number of the material that fills the cell.
    """

    points: int
    cells: int
    of: int
    min_J: float
    position: list[float]
    material: int


def inverted_points(problem: Problem) -> InvertedPoints:
    """Return the inverted points of the problem's state. Collective."""
    u = local_values(problem.split(problem.x)[0])
    counts, worst = np.zeros(3, dtype=np.int64), (np.inf, [0.0] * 3, 0)
    for number, part in enumerate(problem.elastic.parts):
        J = 1 + point_volumes(part.loops.tables, u).growth
        inverted = J <= 0
        counts += [inverted.sum(), inverted.any(axis=1).sum(), J.size]
        if J.size and J.min() < worst[0]:
            cell = np.unravel_index(J.argmin(), J.shape)[0]
            centre = cell_centres(part.loops.tables, np.array([cell]))[0].tolist()
            worst = (float(J.min()), centre, number)
    counts = problem.comm.allreduce(counts)
    everywhere: list[Any] = problem.comm.allgather(worst)
    points, cells, of = (int(n) for n in counts)
    return InvertedPoints(points, cells, of, *min(everywhere))
