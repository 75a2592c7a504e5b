r"""The volume that cells with straight edges leave out of a body with round faces.

Where facets meet at small angles they are likely to stand for a round face. Its normals at a vertex
are then about the means of those of the facets around it, and its distance from the middle of an
edge from a to b of length l is :math:`l\, (n_b - n_a) \cdot t / 8` with the unit vector t along the
edge, as of a parabola. A surface of degree 2 with these distances encloses the rest of the volume.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.mesh.mesh import volume

Array = npt.NDArray[Any]

#: Largest angle between neighbours of a round face; a circle of eight edges has 45 degrees.
_LARGEST_BEND = 46.0


#: Parts of the volume below this one are zero.
_ROUNDING = 1e-12
#: The least part of the volume that is reported, and the least bend from facet to facet [degrees],
#: as a hole is a small part of a plate: a circle of 72 edges is 0.1 % of its radius inside of them.
_LEAST, _LEAST_BEND = 1e-4, 5.0


class RoundFaces(NamedTuple):
    """What round faces would change of the volume of a mesh with straight edges, over its volume.

    Attributes
    ----------
    added, removed : float
        What convex and hollow faces would add and remove.
    bend : float
        The largest angle between neighbouring facets of such a face [degrees].
    """

    added: float
    removed: float
    bend: float = 0.0

    @property
    def text(self) -> str:
        """The line that says that errors do not include this; "" for little."""
        if self.added + self.removed < _LEAST and self.bend < _LEAST_BEND:
            return ""
        return (
            "the errors do not include that of straight edges: faces of the mesh that bend by up "
            f"to {self.bend:.2g} degrees from facet to facet, if they are round, add "
            f"{100 * self.added:.2g} % to its volume and remove {100 * self.removed:.2g} %, and "
            "change stresses at them by more; take cells of order 2 there, or a finer mesh of the "
            "geometry"
        )


def round_faces(domain: Any, revolved: bool = False) -> RoundFaces:
    """Return what round faces would change of the volume of a mesh. Collective.

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh.
    revolved : bool
        Whether it is revolved about the axis x = 0.
    """
    if _dolfinx.geometry_degree(domain) > 1:
        return RoundFaces(0.0, 0.0)
    vertices, x, inside = _gathered_facets(domain)
    normals, sizes, angles = _shapes(x, inside)
    corner_normals = _means_at_corners(vertices, normals, angles)
    # At a corner the normal of the face is in the middle between those of two facets.
    turns = np.linalg.norm(corner_normals - normals[:, None], axis=2).max(initial=0.0)
    missing = np.zeros(len(x))
    cycle = _cycle(x.shape[1])
    for start, end in zip(cycle, [*cycle[1:], cycle[0]], strict=True):
        bend = corner_normals[:, end] - corner_normals[:, start]
        missing += np.einsum("ij,ij->i", bend, x[:, end] - x[:, start]) / 8
    # A parabola over a segment, which has two ends here; bubbles of degree 2 over the other facets.
    missing *= sizes / 3
    if revolved:
        missing *= 2 * np.pi * x[:, :, 0].mean(axis=1)
    whole = volume(domain, revolved)
    parts = [float(np.maximum(part, 0.0).sum() / whole) for part in (missing, -missing)]
    added, removed = (part if part > _ROUNDING else 0.0 for part in parts)
    return RoundFaces(added, removed, float(np.degrees(4 * np.arcsin(turns / 2))))


def _gathered_facets(domain: Any) -> tuple[Array, Array, Array]:
    """Return the facets of the body's surface on all ranks: vertices, their places, a point inside.

    (n, corners), (n, corners, dim), (n, dim).
    """
    _, cells, local = _dolfinx.exterior_facets(domain)
    at = cells[:, None], _dolfinx.reference_facets(_dolfinx.cell_name(domain))[local]
    dim = _dolfinx.mesh_dimension(domain)[0]
    corners = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain), :dim]
    own = _dolfinx.cell_vertices(domain)[at], corners[at], corners[cells].mean(axis=1)
    parts = zip(*domain.comm.allgather(own), strict=True)
    vertices, x, inside = map(np.concatenate, parts)
    return vertices, x, inside


def _cycle(corners: int) -> list[int]:
    """Return the corners of a facet in the order of its edges: 0132 of a quadrilateral."""
    return [0, 1, 3, 2] if corners == 4 else list(range(corners))


def _shapes(x: Array, inside: Array) -> tuple[Array, Array, Array]:
    """Return the unit normals, areas (lengths) and angles at the corners of facets."""
    cycle = _cycle(x.shape[1])
    if x.shape[2] == 2:
        along = x[:, 1] - x[:, 0]
        normals, sizes = np.stack([along[:, 1], -along[:, 0]], axis=1), np.hypot(*along.T)
        angles = np.ones(x.shape[:2])
    else:
        ends = x[:, cycle]
        # The sum over the edges of a plane polygon is twice its area.
        normals = np.cross(ends, np.roll(ends, -1, axis=1)).sum(axis=1) / 2
        sizes = np.linalg.norm(normals, axis=1)
        before, after = np.roll(ends, 1, axis=1) - ends, np.roll(ends, -1, axis=1) - ends
        lengths = np.linalg.norm(before, axis=2) * np.linalg.norm(after, axis=2)
        cosines = np.einsum("ijk,ijk->ij", before, after) / lengths
        angles = np.empty(x.shape[:2])
        angles[:, cycle] = np.arccos(np.clip(cosines, -1.0, 1.0))
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    inwards = np.einsum("ij,ij->i", normals, inside - x.mean(axis=1)) > 0
    normals[inwards] *= -1
    return normals, sizes, angles


def _means_at_corners(vertices: Array, normals: Array, angles: Array) -> Array:
    """Return the normal of the round face at each corner of each facet, (n, corners, dim).

    It is the mean over the facets around it, by their angles there, that are in the same face.
    """
    corners, dim = vertices.shape[1], normals.shape[1]
    order = np.argsort(vertices.ravel(), kind="stable")
    facet, weight = order // corners, angles.ravel()[order]
    number = np.unique(vertices.ravel()[order], return_index=True, return_inverse=True)
    first, at = number[1], number[2].ravel()
    counts = np.diff(np.append(first, len(order)))
    sums = np.zeros((len(order), dim))
    for k in range(counts.max(initial=0)):  # the k-th facet around the vertex of each corner
        known = np.flatnonzero(counts[at] > k)
        other = first[at[known]] + k
        n = normals[facet[other]]
        same = np.einsum("ij,ij->i", n, normals[facet[known]]) >= np.cos(np.radians(_LARGEST_BEND))
        sums[known[same]] += weight[other[same], None] * n[same]
    sums /= np.linalg.norm(sums, axis=1, keepdims=True)
    found = np.empty_like(sums)
    found[order] = sums
    return found.reshape(*vertices.shape, dim)
