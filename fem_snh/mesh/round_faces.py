r"""The volume that straight edges, or edges of degree 2, leave out of a body with round faces.

Facets that meet at small angles are likely to approximate a round face. The face's normal n at a
vertex is then about the mean of the facets' normals there. The distance of the face from the middle
of an edge from a to b is that of a parabola, :math:`l\, (n_b - n_a) \cdot t / 8`, with the edge's
length l and unit vector t. A surface of degree 2 with these distances encloses the missing volume.

The middle of an edge of degree 2 is on the round face, but the facet's normals :math:`m_a, m_b` at
its ends differ from n. With :math:`n - m` in place of n, the gap to the round face, zero at both
ends and in the middle, has a fifth of the parabola's area.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.mesh.mesh import volume

#: Largest angle between neighbours of a round face, by the degree of the edges: a circle of eight
#: straight edges has 45 degrees, one of three edges of degree 2 has 22.
_LARGEST_BEND = {1: 46.0, 2: 23.0}


#: Lower bound of lengths in denominators.
_TINY = np.finfo(float).tiny
#: Fractions of the volume below this are zero.
_ROUNDING = 1e-12
#: Least fraction of the volume that is reported, and least bend from facet to facet [degrees] that
#: always is, as a hole may be a small part of a plate: 72 edges are within 0.1 % of a radius.
_LEAST, _LEAST_BEND = 1e-4, 5.0
#: Least reported fraction for edges of degree 2: a circle of 8 lacks 8e-4, a circle of 4 0.012.
_LEAST_OF_CURVED = 1e-3
#: The area between a round edge and an edge of degree 2, over the area of a parabola with the same
#: slopes; for triangles on a ball it is up to 0.75.
_OF_PARABOLA = 0.2
#: An edge of degree 2 belongs to a round face if it bends by more than this fraction of the face's
#: bend (0.8 in a circle of three edges); elsewhere facets meet at an edge of the body.
_CURVED = 0.75


class RoundFaces(NamedTuple):
    """The change of a mesh's volume by round faces, relative to the volume.

    Attributes
    ----------
    added : float
        The fraction that convex faces would add.
    removed : float
        The fraction that concave faces would remove.
    bend : float
        The largest angle between neighbouring facets of a round face [degrees].
    degree : int
        The degree of the edges, 1 or 2.
    """

    added: float
    removed: float
    bend: float = 0.0
    degree: int = 1

    @property
    def text(self) -> str:
        """The note that estimated errors do not include the change; "" for small changes."""
        least = _LEAST if self.degree == 1 else _LEAST_OF_CURVED
        if self.added + self.removed < least and self.bend < _LEAST_BEND:
            return ""
        edges = "straight edges" if self.degree == 1 else "edges of degree 2"
        instead = "take cells of order 2 there, or a" if self.degree == 1 else "take a"
        return (
            f"the errors do not include that of {edges}: faces of the mesh that bend by up "
            f"to {self.bend:.2g} degrees from facet to facet, if they are round, add "
            f"{100 * self.added:.2g} % to its volume and remove {100 * self.removed:.2g} %, and "
            f"change stresses at them by more; {instead} finer mesh of the geometry"
        )


def round_faces(domain: _dolfinx.Mesh, revolved: bool = False) -> RoundFaces:
    """Return the change of a mesh's volume by round faces; 0 for a degree above 2. Collective.

    Parameters
    ----------
    domain : dolfinx Mesh
        The mesh.
    revolved : bool
        Whether the mesh is revolved about the axis x = 0.
    """
    degree = _dolfinx.geometry_degree(domain)
    if degree > 2:
        return RoundFaces(0.0, 0.0)
    vertices, x, inside, at_corners = _gathered_facets(domain)
    normals, sizes, angles = _shapes(x, inside)
    # The facet's own normals at its corners.
    own = np.broadcast_to(normals[:, None], x.shape) if degree == 1 else at_corners
    corner_normals = _means_at_corners(vertices, own, angles, _LARGEST_BEND[degree])
    # At a corner the face's normal is in the middle between the normals of two facets.
    turns = np.linalg.norm(corner_normals - own, axis=2) if degree == 1 else np.zeros(1)
    angle = 2 * np.arcsin(turns.max(initial=0.0) / 2)
    missing = np.zeros(len(x))
    cycle = _cycle(x.shape[1])
    for start, end in zip(cycle, [*cycle[1:], cycle[0]], strict=True):
        edge = x[:, end] - x[:, start]
        slopes = [_slope(corner_normals[:, i], own[:, i], edge) for i in (start, end)]
        rest = slopes[1] - slopes[0]
        if degree == 2:
            bent = np.einsum("ij,ij->i", own[:, end] - own[:, start], edge)
            is_round = np.abs(bent) > _CURVED * np.abs(bent + rest)
            rest *= np.where(is_round, _OF_PARABOLA, 0.0)
            sines = np.abs(slopes)[:, is_round] / np.linalg.norm(edge, axis=1)[is_round]
            angle = max(angle, np.arcsin(min(sines.max(initial=0.0), 1.0)))
        missing += rest / 8
    # A parabola over a segment, whose two ends both count; bubbles of degree 2 over other facets.
    missing *= sizes / 3
    if revolved:
        missing *= 2 * np.pi * x[:, :, 0].mean(axis=1)
    whole = volume(domain, revolved)
    parts = [float(np.maximum(part, 0.0).sum() / whole) for part in (missing, -missing)]
    added, removed = (part if part > _ROUNDING else 0.0 for part in parts)
    return RoundFaces(added, removed, float(np.degrees(2 * angle)), degree)


def _slope(normals: Array, own: Array, edge: Array) -> Array:
    """Return an edge's length times the component of ``normals`` along its tangent, (n,).

    The tangent at an end is the edge projected on the plane of the facet with the normal ``own``.
    """
    along = edge - np.einsum("ij,ij->i", own, edge)[:, None] * own
    size = np.linalg.norm(edge, axis=1) / np.maximum(np.linalg.norm(along, axis=1), _TINY)
    return np.asarray(size * np.einsum("ij,ij->i", normals, along))


def _gathered_facets(domain: _dolfinx.Mesh) -> tuple[Array, Array, Array, Array]:
    """Return the facets of the body's surface on all ranks. Collective.

    Returns
    -------
    vertices : (n, corners) int
        Global vertices.
    x, inside : (n, corners, dim), (n, dim)
        Positions of the vertices, and of a point in the facet's cell [m].
    normals : (n, corners, dim)
        See `_normals_at_corners`.
    """
    _, cells, local = _dolfinx.exterior_facets(domain)
    at = cells[:, None], _dolfinx.reference_facets(_dolfinx.cell_name(domain))[local]
    dim = _dolfinx.mesh_dimension(domain)[0]
    corners = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain), :dim]
    normals = _normals_at_corners(domain, corners[cells], local)
    own = _dolfinx.cell_vertices(domain)[at], corners[at], corners[cells].mean(axis=1), normals
    parts = zip(*domain.comm.allgather(own), strict=True)
    vertices, x, inside, normals = map(np.concatenate, parts)
    return vertices, x, inside, normals


def _normals_at_corners(domain: _dolfinx.Mesh, nodes: Array, local: Array) -> Array:
    """Return the outward unit normals of facets at their corners, (n, corners, dim).

    ``nodes`` (n, nodes, dim) are positions in the facets' cells, ``local`` the facets' numbers.
    """
    cell = _dolfinx.cell_name(domain)
    gradients = _dolfinx.tabulate_geometry(domain, _dolfinx.reference_corners(cell))
    corners = _dolfinx.reference_facets(cell)[local]
    # dx/dxi at each corner, and the tangents of the reference facet.
    F = np.einsum("fcnj,fni->fcij", gradients[corners], nodes)
    tangents = np.einsum("fcij,fkj->fcki", F, _dolfinx.facet_maps(cell)[1][local])
    if tangents.shape[2] == 1:
        normals = tangents[:, :, 0, ::-1] * (1, -1)
    else:
        normals = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    normals = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    middle = nodes[:, : len(_dolfinx.reference_corners(cell))].mean(axis=1)
    at = np.arange(len(nodes))[:, None], corners
    inwards = np.einsum("fci,fci->fc", normals, middle[:, None] - nodes[at]) > 0
    normals[inwards] *= -1
    return np.asarray(normals)


def _cycle(corners: int) -> list[int]:
    """Return the corners of a facet in cyclic order: 0, 1, 3, 2 for a quadrilateral."""
    return [0, 1, 3, 2] if corners == 4 else list(range(corners))


def _shapes(x: Array, inside: Array) -> tuple[Array, Array, Array]:
    """Return outward unit normals, areas (in 2D lengths), and angles at corners (1 in 2D)."""
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


def _means_at_corners(vertices: Array, normals: Array, angles: Array, bend: float) -> Array:
    """Return the normals of the round faces at the corners of facets, (n, corners, dim).

    Each is the mean, weighted by angles, of the facets' normals at the vertex that differ from the
    facet's own normal by at most ``bend`` degrees: these facets are in the same face.
    """
    dim = normals.shape[2]
    order = np.argsort(vertices.ravel(), kind="stable")
    normals, weight = normals.reshape(-1, dim)[order], angles.ravel()[order]
    number = np.unique(vertices.ravel()[order], return_index=True, return_inverse=True)
    first, at = number[1], number[2].ravel()
    counts = np.diff(np.append(first, len(order)))
    sums = np.zeros((len(order), dim))
    for k in range(counts.max(initial=0)):  # the k-th facet around the vertex of each corner
        known = np.flatnonzero(counts[at] > k)
        other = first[at[known]] + k
        n = normals[other]
        same = np.einsum("ij,ij->i", n, normals[known]) >= np.cos(np.radians(bend))
        sums[known[same]] += weight[other[same], None] * n[same]
    sums /= np.linalg.norm(sums, axis=1, keepdims=True)
    found = np.empty_like(sums)
    found[order] = sums
    return found.reshape(*vertices.shape, dim)
