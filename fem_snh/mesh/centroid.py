"""The centroid of a group of cells or facets."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx

Array = npt.NDArray[Any]

#: Quadrature degree: exact on affine cells and on parallelograms.
_DEGREE = 4


def centroid(domain: Any, dim: int, entities: Array) -> Array:
    """Return the centroid (3,) of cells or facets, in the reference configuration. Collective.

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh.
    dim : int
        The dimension of the entities, that of the cells or one less.
    entities : (n,) int
        Those of this rank, ghosts included.
    """
    cell = _dolfinx.cell_name(domain)
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)][..., : domain.topology.dim]
    shares, kind = np.isin(np.arange(_dolfinx.num_owned(domain)), entities)[:, None] * 1.0, cell
    origins, tangents = np.zeros((1, x.shape[2])), np.eye(x.shape[2])[None]
    if dim < domain.topology.dim:
        kind, facets = _dolfinx.FACET_OF[cell], _dolfinx.cell_facets(domain)
        exterior = np.isin(facets, _dolfinx.exterior_facets(domain)[0])
        shares = np.isin(facets, entities) * np.where(exterior, 1.0, 0.5)  # of two cells
        origins, tangents = _dolfinx.facet_maps(cell)
    points, weights = _dolfinx.quadrature(kind, _DEGREE)
    sums = np.zeros(4)
    for share, origin, tangent in zip(shares.T, origins, tangents, strict=True):
        nodes = x[: len(share)][share > 0]
        at = origin + points @ tangent
        T = np.einsum("cai,qak->cqik", nodes, _dolfinx.tabulate_geometry(domain, at)) @ tangent.T
        sizes = np.sqrt(np.linalg.det(np.swapaxes(T, 2, 3) @ T)) * weights
        sizes *= share[share > 0][:, None]
        places = np.einsum("cai,qa->cqi", nodes, _dolfinx.tabulate_geometry_values(domain, at))
        sums[3] += sizes.sum()
        sums[: x.shape[2]] += np.einsum("cq,cqi->i", sizes, places)
    sums = domain.comm.allreduce(sums)
    return np.asarray(sums[:3] / sums[3])
