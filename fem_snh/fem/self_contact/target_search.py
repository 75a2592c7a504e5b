"""The search for samples inside of deformed cells, and for their targets on the surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.fem.contact.embedded_surface import EmbeddedSurface
from fem_snh.fem.contact.triangles import PseudoNormals, triangle_normals
from fem_snh.fem.regions import Region
from fem_snh.fem.self_contact.approaching import approaching
from fem_snh.fem.self_contact.closer_targets import CloserTargets
from fem_snh.fem.self_contact.deformed_cells import OUTSIDE, DeformedCells
from fem_snh.fem.self_contact.neighbourhood import Neighbourhood, body_numbers
from fem_snh.fem.self_contact.pairs import ContactPairs
from fem_snh.fem.self_contact.reference_surface import ReferenceSurface
from fem_snh.fem.self_contact.samples import (
    SurfaceSamples,
    cell_sizes,
    cell_stiffness,
    smallest_at_points,
)

Array = npt.NDArray[Any]

#: Reference positions of a sample in two cells that are closer than this part of a cell count as
#: one: the cells are neighbours.
_SAME = 0.5
#: Samples in front of another part of the surface, closer to it than this part of a cell, may touch
#: in the next solve. Without them, the flesh of a finger that bends passes through itself by 2.7
#: cells in a solve: the scene hand, step 35, takes 47 Newton iterations instead of 22. With an
#: entire cell, blocks of two cells (tests/test_reference_contact.py) tilt.
_APPROACH = 0.5
#: Columns of the hits that the ranks exchange: sample, distance outside, cell size, triangle,
#: barycentric coordinates (3), reference position (3).
_COLUMNS = 10


class TargetSearch:
    """Samples of a surface and their targets. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    surface : EmbeddedSurface
        The surface.
    regions : sequence of Region
        The materials.
    stiffness : float, optional
        Contact pressure over penetration [Pa/m]; default: of the softer one of sample and target.
    overlap : bool
        Whether cells of one body overlap in the reference configuration, as a lattice's do where
        parts of its surface pass through one cube.

    Attributes
    ----------
    samples : SurfaceSamples
        The samples.
    stiffness, size : float
        The mean stiffness over the surface [Pa/m], the mean size of the cells [m].
    """

    def __init__(
        self,
        V: Any,
        surface: EmbeddedSurface,
        regions: Sequence[Region],
        stiffness: float | None = None,
        overlap: bool = False,
    ) -> None:
        self._comm, self._surface, self._overlap = V.mesh.comm, surface, overlap
        self._sizes = cell_sizes(V)
        sizes = smallest_at_points(V, surface, self._sizes)
        self.samples = SurfaceSamples(surface, sizes)
        if stiffness is None:
            values = smallest_at_points(V, surface, cell_stiffness(V, regions))
        else:
            values = np.full(len(surface.points), stiffness)
        self._stiffness = values
        areas = self.samples.areas / self.samples.areas.sum()
        self.stiffness, self.size = (float(areas @ self.samples.at(v)) for v in (values, sizes))
        self._cells = DeformedCells(V)
        self._near = Neighbourhood(V, surface)
        bodies = body_numbers(V)
        self._cell_bodies = bodies[self._cells.nodes[:, 0]]
        of_points = surface.support.gather(bodies[:, None])[surface.columns[:, 0], 0]
        triangles = surface.triangles
        self._reference = ReferenceSurface(surface.points, triangles, of_points[triangles[:, 0]])
        self._normals, self._closer = PseudoNormals(triangles), CloserTargets(triangles)

    def find(self, u: Array, x: Array) -> ContactPairs:
        """Return the pairs of the samples inside of the body or close to its surface. Collective.

        Parameters
        ----------
        u : (local nodes, 3)
            Nodal displacements [m].
        x : (points, 3)
            The positions of the surface's points [m].
        """
        points, outward = self.samples.at(x), triangle_normals(x, self._surface.triangles)
        hits = np.concatenate(self._comm.allgather(self._own_hits(u, x, points, outward)))
        hits = _without_repeated(hits)
        others = self._approaching(x, points, outward, hits[:, 0])
        others = np.concatenate(self._comm.allgather(others))
        hits = np.concatenate([hits[:, [0, 3, 4, 5, 6]], others])
        hits = hits[np.argsort(hits[:, 0], kind="stable")]
        sample, target = hits[:, 0].astype(int), hits[:, 1].astype(int)
        coordinates, samples = hits[:, 2:], self.samples
        corners = [
            self._surface.triangles[samples.triangle[sample]],
            self._surface.triangles[target],
        ]
        k = [
            np.einsum("nk,nk->n", b, self._stiffness[c])
            for b, c in zip((samples.coordinates[sample], coordinates), corners, strict=True)
        ]
        # Where two surfaces touch, the samples of both have half of the stiffness each.
        spring = samples.areas[sample] * np.minimum(*k) / 2
        return ContactPairs(
            sample,
            np.concatenate(corners, axis=1),
            np.concatenate([samples.coordinates[sample], -coordinates], axis=1),
            self._normals.at(x, target, coordinates),
            spring,
        )

    def _own_hits(self, u: Array, x: Array, points: Array, outward: Array) -> Array:
        """Return the samples in this rank's cells and their targets, (n, _COLUMNS).

        ``points`` are the positions of the samples, ``outward`` the triangles' normals.
        """
        triangle = self.samples.triangle

        def excluded(sample: Array, cell: Array) -> Array:
            return self._near.share(triangle[sample], cell)

        hits = self._cells.find(u, points, excluded)
        own, size = triangle[hits.point], self._sizes[hits.cell]
        normals = outward[own]
        bodies = self._cell_bodies[hits.cell]
        target, coordinates, depth = self._reference.closest(hits.X, bodies, normals, outward)
        kept = (depth >= -OUTSIDE * size) & ~self._near.touch(own, target)
        if self._overlap:
            # A target in the sample's own part of the body, if it is closer than the edge of a
            # cube, is on a cube that touches the sample's one.
            kept &= (depth > size) | self._near.share(target, hits.cell)
        target, coordinates = self._closer.move(points[hits.point], normals, target, x, outward)
        # Two parts of a surface whose outward normals point to the same side do not touch.
        opposed = np.einsum("ni,ni->n", normals, outward[target]) <= 0
        kept &= opposed & ~self._near.touch(own, target)
        columns = (hits.point, np.maximum(hits.outside, 0.0), size, target)
        found = np.column_stack([*columns, coordinates, hits.X])
        return np.asarray(found[kept].reshape(-1, _COLUMNS))

    def _approaching(self, x: Array, points: Array, outward: Array, inside: Array) -> Array:
        """Return this rank's share of samples that may touch in the next solve, (n, 5).

        Columns: sample, triangle, barycentric coordinates (3). The arguments are those of
        `_own_hits`, and the samples ``inside`` of the body.
        """
        samples, triangles = self.samples, self._surface.triangles
        count = len(samples)
        first, last = (count * (self._comm.rank + i) // self._comm.size for i in (0, 1))
        chosen = np.setdiff1d(np.arange(first, last), inside.astype(int))
        normals, distance = outward[samples.triangle], _APPROACH * self.size
        found = approaching(points, normals, chosen, x[triangles], outward, distance)
        kept = ~self._near.touch(samples.triangle[found.sample], found.triangle)
        columns = found.sample, found.triangle, found.coordinates
        return np.asarray(np.column_stack(columns)[kept].reshape(-1, 5))


def _without_repeated(hits: Array) -> Array:
    """Return the hits (n, _COLUMNS) sorted by sample, one for each place of a sample."""
    # Rounded, as ranks may differ by rounding errors.
    order = np.lexsort((*np.round(hits[:, 7:] / hits[:, 2:3], 6).T, hits[:, 1], hits[:, 0]))
    hits = hits[order]
    repeated = np.zeros(len(hits), bool)
    for shift in range(1, len(hits)):
        same = hits[shift:, 0] == hits[:-shift, 0]
        if not same.any():
            break
        apart = np.linalg.norm(hits[shift:, 7:] - hits[:-shift, 7:], axis=1)
        repeated[shift:] |= same & (apart < _SAME * hits[shift:, 2]) & ~repeated[:-shift]
    return np.asarray(hits[~repeated])
