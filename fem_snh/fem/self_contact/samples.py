"""Sample points of a body's surface: quadrature points of its triangles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.fem.contact.embedded_surface import EmbeddedSurface
from fem_snh.fem.mesh import cell_volumes
from fem_snh.fem.regions import Region

Array = npt.NDArray[Any]

#: Default stiffness in E over the size of the cell. In the clip of docs/howto, closed by 0.25 from
#: either side, 10, 30 and 50 leave 3.8, 1.7 and 1.0 % of a cell, in 16 to 19 Newton iterations.
FACTOR = 50.0
#: Samples for each face of a cell. A triangle has 1, 3 or 6 samples, the fewest that suffice.
_SAMPLES_PER_FACE = 6
#: Degrees of the rules with 1, 3 and 6 points.
_DEGREES = (1, 2, 4)
#: Cells that fill the cube by whose edge their size is measured.
_CELLS_PER_CUBE = {"tetrahedron": 6.0, "hexahedron": 1.0}


class SurfaceSamples:
    """Quadrature points of a surface's triangles.

    Parameters
    ----------
    surface : EmbeddedSurface
        The surface.
    sizes : (points,)
        The size of the cells at its points [m].

    Attributes
    ----------
    triangle : (n,) int
        The triangle of each sample.
    coordinates : (n, 3)
        Barycentric coordinates in it.
    areas : (n,)
        Quadrature weights in the reference configuration [m^2].
    """

    def __init__(self, surface: EmbeddedSurface, sizes: Array) -> None:
        a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        faces = sizes[surface.triangles].mean(axis=1) ** 2
        wanted = _SAMPLES_PER_FACE * areas.mean() / faces.mean()
        rules = [_dolfinx.quadrature("triangle", degree) for degree in _DEGREES]
        points, weights = next((r for r in rules if len(r[1]) >= wanted), rules[-1])
        self._surface, count = surface, len(weights)
        self.triangle = np.repeat(np.arange(len(areas)), count)
        barycentric = np.column_stack([1 - points.sum(axis=1), points])
        self.coordinates = np.tile(barycentric, (len(areas), 1))
        # The weights of the reference triangle sum to its area 1/2.
        self.areas = np.outer(areas, 2 * weights).ravel()

    def __len__(self) -> int:
        return len(self.triangle)

    def at(self, x: Array) -> Array:
        """Return values at the samples (n, 3) of values at the surface's points."""
        return surface_values(x, self._surface.triangles[self.triangle], self.coordinates)


def surface_values(x: Array, corners: Array, coordinates: Array) -> Array:
    """Return the values (n, ...) of points with barycentric coordinates (n, 3) in triangles."""
    return np.asarray(np.einsum("nk,nk...->n...", coordinates, x[corners]))


def cell_sizes(V: Any) -> Array:
    """Return the edge of a cube of each owned cell's volume [m]; six tetrahedra fill a cube."""
    factor = _CELLS_PER_CUBE[_dolfinx.cell_name(V.mesh)]
    return np.asarray((factor * cell_volumes(V.mesh)) ** (1 / 3))


def cell_stiffness(V: Any, regions: Sequence[Region]) -> Array:
    """Return the default penalty stiffness of each owned cell [Pa/m]: `FACTOR` E over its size."""
    moduli = np.empty(_dolfinx.num_owned(V.mesh))
    for region in regions:
        moduli[region.cells] = region.material.numbers.E
    return np.asarray(FACTOR * moduli / cell_sizes(V))


def smallest_at_points(V: Any, surface: EmbeddedSurface, values: Array) -> Array:
    """Return the smallest value (points,) of the cells (owned cells,) at each point. Collective."""
    nodes, smallest = _dolfinx.node_dofs(V), np.full(sum(_dolfinx.num_nodes(V)), np.inf)
    np.minimum.at(smallest, nodes.ravel(), np.repeat(values, nodes.shape[1]))
    numbers = _dolfinx.local_to_global(V)
    found = np.full(len(surface.support.nodes), np.inf)
    known = np.isin(numbers, surface.support.nodes)
    found[np.searchsorted(surface.support.nodes, numbers[known])] = smallest[known]
    found = np.min(V.mesh.comm.allgather(found), axis=0)
    return np.asarray(found[surface.columns].min(axis=1))
