"""Which shapes have sharp edges, beside which strains are infinite in the flesh around them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.geometry.shapes.box import Plane
from fem_snh.geometry.shapes.closed_surface import ClosedSurface
from fem_snh.geometry.shapes.round_shapes import Capsule, Revolved, Sphere
from fem_snh.geometry.shapes.shape import Shape
from fem_snh.geometry.shapes.unions import SmoothUnion, Union

Array = npt.NDArray[Any]

#: Triangles of a surface whose outward normals differ by a larger angle meet in an edge [degrees]:
#: a sphere of 8 triangles around its equator has none, a cube and an octagonal prism have some.
_EDGE = 45.5


def has_edges(shape: Shape) -> bool:
    """Return whether a shape has convex edges. Seams of a union are concave."""
    if isinstance(shape, Union | SmoothUnion):
        return any(has_edges(part) for part in shape.shapes)
    if isinstance(shape, Revolved):
        return has_edges(shape.section)
    if isinstance(shape, ClosedSurface):
        return _largest_fold(shape) > _EDGE
    return not isinstance(shape, Capsule | Plane | Sphere)


def _largest_fold(surface: ClosedSurface) -> float:
    """Return the largest angle at a convex edge of two triangles [degrees]; 0 without one."""
    corners = surface.points[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    edges = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owners = np.repeat(np.arange(len(corners)), 3)[np.lexsort(edges.T)].reshape(-1, 2)
    first, second = owners.T
    outwards = corners.mean(axis=1)[second] - corners.mean(axis=1)[first]
    convex = np.einsum("ij,ij->i", outwards, normals[first]) < 0
    cosines = np.einsum("ij,ij->i", normals[first], normals[second])[convex]
    return float(np.degrees(np.arccos(np.clip(cosines.min(initial=1.0), -1.0, 1.0))))
