"""The deepest point of a surface in contact, also where no quadrature point is.

Contact acts at quadrature points inside of the facets. A corner, an edge or a small obstacle may
pass between them without a force. After a step the gap is evaluated at a grid on each facet, too,
which contains its nodes. An obstacle, or a corner of the other body, that touches a facet between
the points of this grid is not seen; of one that is, the depth is that at the grid's points.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: Intervals of the grid along an edge: the nodes of degree 1 and 2, and as many points between.
_INTERVALS = 4
#: Over the penetration of quadrature points. A linear gap that is zero in the middle of a facet is
#: 1.7 (2 x 2 points) or 2 times (3 points) as deep at a vertex as at the points: they see it.
_FACTOR = 2.0
#: In sizes of the facet: less takes a few percent of the force (docs/howto/obstacles.md).
_LEAST = 0.05


class DeepestPoint(NamedTuple):
    """The deepest point of a surface.

    Attributes
    ----------
    depth : float
        Its depth [m]; 0 if the surface is outside.
    size : float
        Square root of the area at rest of its facet, the smallest one of several [m].
    position : list of float
        Its present coordinates [m].
    """

    depth: float = 0.0
    size: float = np.inf
    position: list[float] = []

    @classmethod
    def among(cls, gaps: Array, areas: Array, x: Array) -> DeepestPoint:
        """Return the deepest of some points.

        Parameters
        ----------
        gaps : (facets, points)
            Signed distances [m].
        areas : (facets,)
            Areas of the facets [m^2].
        x : (facets, points, 3)
            Positions [m].
        """
        lowest = float(gaps.min(initial=0.0))
        if lowest >= 0:
            return cls()
        facets, points = np.nonzero(gaps == lowest)
        i = areas[facets].argmin()
        return cls(-lowest, float(areas[facets[i]] ** 0.5), x[facets[i], points[i]].tolist())

    @staticmethod
    def deepest(points: Iterable[DeepestPoint]) -> DeepestPoint:
        """Return the deepest of several: of those at a node the one of the smallest facet."""
        return min(points, key=lambda p: (-p.depth, p.size, p.position))

    def row(self, penetration: float) -> dict[str, Any]:
        """Return what run.json has of it.

        ``deepest`` [m]; where quadrature points of this penetration [m] do not see it,
        ``deepest_at``, its position.
        """
        unseen = self.depth > max(_FACTOR * penetration, _LEAST * self.size)
        return {"deepest": self.depth} | ({"deepest_at": self.position} if unseen else {})


def facet_grid(kind: str) -> Array:
    """Return the grid's points on the reference facet, (n, 2): 15 of a triangle, 25 of others."""
    s = np.arange(_INTERVALS + 1)
    points = np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1).reshape(-1, 2)
    if kind == "triangle":
        points = points[points.sum(axis=1) <= _INTERVALS]
    return points / _INTERVALS
