"""Triangles and tetrahedra in place of quadrilaterals and hexahedra, with the mesh's groups.

A hexahedron becomes six tetrahedra: its vertex with the least number is the apex of a pyramid on
each of the three faces that do not have it. A face is divided by the diagonal from its own vertex
with the least number, so both of its cells divide it alike (Dompierre et al. 1999). Only rank 0
has the mesh.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.errors import BadInput
from fem_snh.mesh.bisection import with_midpoints
from fem_snh.mesh.gmsh_model import MeshData

#: The simplices that take the place of other cells.
SIMPLEX_OF = {"quadrilateral": "triangle", "hexahedron": "tetrahedron"}


def in_simplices(data: MeshData) -> tuple[MeshData, Array]:
    """Return a mesh of quadrilaterals or hexahedra, divided into two or six simplices. On rank 0.

    Edges stay straight, or on the curved cells. Faces of hexahedra whose corners are not in a plane
    become two triangles.

    Parameters
    ----------
    data : MeshData
        The mesh, in dolfinx's order of nodes.

    Returns
    -------
    MeshData, (simplices,) array
        The mesh, and the original cell of which each simplex is a part.

    Raises
    ------
    BadInput
        If a hexahedron is too warped to be divided.
    """
    dim, cell = data.x.shape[1], SIMPLEX_OF[data.cell]
    vertices, corners = np.unique(data.cells[:, : 2**dim], return_inverse=True)
    corners = corners.reshape(-1, 2**dim)
    local, roots = _divided(corners, dim)
    cells, x = corners[roots[:, None], local], data.x[vertices]
    reference = _dolfinx.reference_corners(data.cell)[local]
    signs = np.sign(np.linalg.det(x[cells][:, 1:] - x[cells][:, :1]))
    signs *= np.sign(np.linalg.det(reference[:, 1:] - reference[:, :1]))
    of_cells = np.sign(np.bincount(roots, signs))[roots]  # some cells may be left-handed
    if not (signs == of_cells).all():
        warped = roots[signs != of_cells][0]
        at = ", ".join(f"{c:.4g}" for c in x[corners[warped]].mean(axis=0))
        raise BadInput(f"the {data.cell} at ({at}) is too warped to be divided into simplices")
    groups = []
    for group in data.groups:
        entities = group.entities
        if group.dim == dim:
            entities = np.flatnonzero(np.isin(roots, entities))
        else:
            entities = np.searchsorted(vertices, entities)
            if group.dim == 2:
                parts, faces = _divided(entities, 2)
                entities = entities[faces[:, None], parts]
        groups.append(group._replace(entities=entities))
    if data.degree == 2:
        cells, x = with_midpoints(data, cell, cells, x, roots, reference)
    return data._replace(cells=cells, x=x, cell=cell, groups=groups), roots


def _divided(corners: Array, dim: int) -> tuple[Array, Array]:
    """Return the local corners of simplices (n, dim + 1), and the row of which each is a part.

    Parameters
    ----------
    corners : (cells, 2**dim) array
        The vertices of quadrilaterals or hexahedra, at (0, 0), (1, 0), (0, 1), (1, 1) and so on.
    dim : int
        Their dimension.
    """
    first = corners.argmin(axis=1)
    rows = np.arange(len(corners))
    if dim == 2:  # the least vertex, the opposite one, and each of the other two
        parts = np.array([[first, first ^ 1, first ^ 3], [first, first ^ 3, first ^ 2]])
        return parts.transpose(2, 0, 1).reshape(-1, 3), np.repeat(rows, 2)
    found, origins = [], []
    for axis in range(3):  # the face opposite to the least vertex along the axis
        others = [2**i for i in range(3) if i != axis]
        offsets = np.array([a * others[0] + b * others[1] for b, a in product((0, 1), repeat=2)])
        base = (first ^ 2**axis) & 2**axis
        faces = base[:, None] + offsets
        parts, owners = _divided(corners[rows[:, None], faces], 2)
        triangles = faces[owners[:, None], parts]
        found.append(np.column_stack([first[owners], triangles]))
        origins.append(owners)
    order = np.argsort(np.concatenate(origins), kind="stable")
    return np.concatenate(found)[order], np.concatenate(origins)[order]
