"""The facets of a surface that may touch an obstacle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.contact.surfaces.surface_quadrature import SurfaceQuadrature

Array = npt.NDArray[Any]

#: Distance by which nodes may move before the facets are searched again, in mean radii of facets. A
#: larger one costs evaluations at more points, a smaller one more searches.
_MARGIN = 1.0


class NearFacets:
    """The facets with points at or below distance zero, and others that are close to it.

    A signed distance grows by at most the length of a way, so a facet whose centre is at a
    distance above the facet's radius has no point at distance zero. The list stays valid while no
    node moves by more than a margin relative to the obstacle, so that most evaluations only compare
    the nodes' positions.

    Parameters
    ----------
    surface : SurfaceQuadrature
        The facets.
    X : (local nodes, 3)
        Reference coordinates of the displacement's nodes [m].
    distance : callable
        Returns the signed distances (n,) of points (n, 3).
    facets : (n,) int, optional
        Local numbers of the facets that may touch the obstacle. Default: all of the surface.
    material : callable, optional
        Returns the material points of the obstacle that are at points (n, 3). Default: it rests.
    """

    def __init__(
        self,
        surface: SurfaceQuadrature,
        X: Array,
        distance: Callable[[Array], Array],
        facets: Array | None = None,
        material: Callable[[Array], Array] = np.asarray,
    ) -> None:
        chosen = slice(None) if facets is None else np.isin(surface.facets, facets)
        self._indices = np.arange(len(surface))[chosen]
        corners = surface.nodes[chosen]
        self._nodes, nodes = np.unique(corners, return_inverse=True)
        self._corners = nodes.reshape(corners.shape)
        self._X, self._distance, self._material = X[self._nodes], distance, material
        # |x_q - c| <= sum |N_a| max |x_a - c|, as the shape functions sum to 1.
        self._spread = np.abs(surface.basis).sum(axis=1).max()
        radii = self._balls(self._X)[1]
        self._margin = _MARGIN * float(radii.mean()) if len(radii) else 0.0
        self._searched: Array | None = None
        self._found: Array = np.empty(0, int)
        self._valid = 0.0

    def at(self, u: Array) -> Array:
        """Return the indices of facets, sorted (m,).

        Parameters
        ----------
        u : (local nodes, 3)
            Nodal displacements [m], ghosts included.
        """
        x = self._X + u[self._nodes]
        relative = self._material(x)
        if self._searched is not None:
            way = relative - self._searched
            moved = np.einsum("ni,ni->n", way, way).max(initial=0.0)
            if self._spread**2 * moved <= self._valid**2:
                return self._found
        self._searched = relative
        self._found, self._valid = np.empty(0, int), self._gap_of_all(x)
        if self._valid <= self._margin:
            centers, radii = self._balls(x)
            gaps = self._distance(centers) - radii
            self._found = self._indices[gaps <= self._margin]
            self._valid = max(self._margin, gaps.min(initial=np.inf))
        return self._found

    def _gap_of_all(self, x: Array) -> float:
        """Return the distance of a ball that contains all points, a bound of theirs."""
        if not len(x):
            return np.inf
        low, high = x.min(axis=0), x.max(axis=0)
        radius = self._spread * np.linalg.norm(high - low) / 2
        return float(self._distance((low + high)[None] / 2)[0] - radius)

    def _balls(self, x: Array) -> tuple[Array, Array]:
        """Return centres (facets, 3) and radii (facets,) of balls that contain the points."""
        corners = x[self._corners]
        centers = corners.mean(axis=1)
        ways = corners - centers[:, None]
        return centers, self._spread * np.sqrt(np.einsum("fki,fki->fk", ways, ways).max(axis=1))
