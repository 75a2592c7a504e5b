"""Facets of the body's boundary: their cells, and points on the facets of the reference cell."""

from __future__ import annotations

from typing import Any

import basix
import dolfinx
import numpy as np

from fem_snh._dolfinx.common import _rows
from fem_snh._dolfinx.meshes import cell_name, num_owned, reference_facets

Array = np.ndarray

#: The facets of each kind of cell.
FACET_OF = {
    "tetrahedron": "triangle",
    "hexahedron": "quadrilateral",
    "triangle": "interval",
    "quadrilateral": "interval",
}


def exterior_facets(domain: Any) -> tuple[Array, Array, Array]:
    """Return the facets on the boundary of the body whose cells this rank owns.

    Returns
    -------
    facets : (n,) int32
        Local numbers, sorted.
    cells : (n,) int32
        The cell of each facet.
    local_facets : (n,) int32
        The facet's number in its reference cell.
    """
    topology, dim = domain.topology, domain.topology.dim
    topology.create_connectivity(dim - 1, dim)
    topology.create_connectivity(dim, dim - 1)
    facets = np.sort(np.asarray(dolfinx.mesh.exterior_facet_indices(topology), dtype=np.int32))
    cells_of = topology.connectivity(dim - 1, dim)
    # An exterior facet has one cell.
    cells = np.asarray(cells_of.array)[np.asarray(cells_of.offsets)[facets]]
    facets_of = _rows(topology.connectivity(dim, dim - 1), len(reference_facets(cell_name(domain))))
    owned = cells < num_owned(domain)
    facets, cells = facets[owned], cells[owned]
    return facets, cells, (facets_of[cells] == facets[:, None]).argmax(axis=1).astype(np.int32)


def facet_maps(cell: str) -> tuple[Array, Array]:
    """Return the affine maps x = origin + s tangents of the reference facets into the cell.

    Returns
    -------
    origins : (facets, dim)
        The images of the reference facet's origin.
    tangents : (facets, dim - 1, dim)
        The derivatives by its coordinates.
    """
    kind = getattr(basix.CellType, cell)
    corners = np.asarray(basix.geometry(kind))
    dim = corners.shape[1]
    facets = basix.topology(kind)[dim - 1]
    origins = np.array([corners[facet[0]] for facet in facets])
    tangents = [[corners[facet[i]] - corners[facet[0]] for i in range(1, dim)] for facet in facets]
    return origins, np.array(tangents)
