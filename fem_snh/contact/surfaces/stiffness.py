"""The default stiffness of contact, from the material and the mesh at the surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.regions import Region
from fem_snh.contact.surfaces.surface_quadrature import SurfaceQuadrature
from fem_snh.mesh.mesh import cell_volumes

Array = npt.NDArray[Any]

#: Penalty stiffness in E over the size of the cell at the facet: where the contact pressure is E/10
#: the penetration is a hundredth of the cell.
#: ``python -m benchmarks hertz --factors 0.1,1,10,100`` measures what it leaves and what it costs.
FACTOR = 10.0
#: Height of a cell over a facet, in its volume over the facet's area.
_HEIGHT = {"tetrahedron": 3.0, "hexahedron": 1.0}


def cell_heights(surface: SurfaceQuadrature, V: Any) -> Array:
    """Return the height of the cell over each facet [m], (facets,)."""
    areas = surface.weights.sum(axis=1)
    factor = _HEIGHT[_dolfinx.cell_name(V.mesh)]
    return np.asarray(factor * cell_volumes(V.mesh)[surface.cells] / areas)


def surface_mean(surface: SurfaceQuadrature, values: Array, comm: Any) -> float:
    """Return the mean over the area of values of the facets. Collective."""
    areas = surface.weights.sum(axis=1)
    total = comm.allreduce(np.array([areas @ values, areas.sum()]))
    return float(total[0] / total[1])


def default_stiffness(surface: SurfaceQuadrature, V: Any, regions: Sequence[Region]) -> Array:
    """Return the default penalty stiffness of each facet [Pa/m], (facets,)."""
    moduli = np.empty(_dolfinx.num_owned(V.mesh))
    for region in regions:
        moduli[region.cells] = region.material.numbers.E
    return np.asarray(FACTOR * moduli[surface.cells] / cell_heights(surface, V))
