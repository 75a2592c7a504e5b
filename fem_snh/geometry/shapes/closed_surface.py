"""A solid bounded by a triangulated surface, from an STL or OBJ file."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import processes
from fem_snh.arrays import Array
from fem_snh.choices import LARGEST_NUMBER
from fem_snh.errors import BadInput, nearest_file
from fem_snh.geometry.shapes.shape import Evaluation, Shape

Triangles = npt.NDArray[np.int64]

#: Distance over the surface's diagonal below which the direction to the closest point is rounding
#: error, and VTK's normal is used. Coordinates have 16 digits, directions need 6.
_ON_SURFACE = 1e-10


@dataclass(frozen=True, eq=False)
class ClosedSurface(Shape):
    """A solid whose surface is a closed set of triangles.

    VTK's ``vtkImplicitPolyDataDistance`` gives the signed distance. Angle-weighted normals
    (Baerentzen & Aanaes 2005) determine the sign, so it is right at edges and corners. Each
    triangle is flat, and the Hessian is taken as zero everywhere, also at edges. On the medial axis
    the gradient is the normal at one of the closest points.

    Attributes
    ----------
    points : (n, 3) array
        Corners of the triangles [length].
    triangles : (m, 3) array
        Indices of each triangle's corners, anticlockwise as seen from outside.
    path : Path or None
        The file, for messages.
    """

    points: Array
    triangles: Triangles
    path: Path | None = field(default=None)

    def __post_init__(self) -> None:
        check_closed(self.points, self.triangles, str(self.path or "ClosedSurface"))

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without VTK's object, so that rank 0 can send the surface to others."""
        return {key: value for key, value in vars(self).items() if not key.startswith("_")}

    @classmethod
    def read(cls, path: str | Path) -> ClosedSurface:
        """Return the surface of an OBJ file, if the suffix is ".obj", or of an STL file.

        Corners with equal coordinates become one. Polygons become triangles. Triangles with two
        equal corners are left out.

        Raises
        ------
        BadInput
            If the file cannot be read, VTK is missing, or the surface is empty, not closed, or
            inverted; a message of one line.
        """
        path = Path(path)
        try:
            path.open("rb").close()
        except OSError as error:
            near = nearest_file(path)
            raise BadInput(f"cannot read the surface {path}: {error.strerror}{near}") from None
        corners = processes.call("VTK", _vtk(path).read_corners, path)
        points, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        triangles = numbers.reshape(-1, 3)
        a, b, c = triangles.T
        triangles = triangles[(a != b) & (b != c) & (c != a)]
        return cls(points, triangles, path)

    @cached_property
    def _distance(self) -> Any:
        """VTK's signed distance function of the surface."""
        return _vtk(self.path).distance_function(self.points, self.triangles)

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        return _vtk(self.path).distances(self._distance, x)

    def evaluate(self, x: Array) -> Evaluation:
        """Return the signed distance at points x (n, 3), with its gradient; the Hessian is zero."""
        x = np.ascontiguousarray(x, dtype=float)
        function, closest = self._distance, np.empty_like(x)
        distance, point = np.empty(len(x)), [0.0, 0.0, 0.0]
        for i, place in enumerate(x):
            distance[i] = function.EvaluateFunctionAndGetClosestPoint(list(place), point)
            closest[i] = point
        near = np.abs(distance) <= _ON_SURFACE * self.diagonal
        gradient = (x - closest) / np.where(near, 1.0, distance)[:, None]
        for k in np.flatnonzero(near):
            function.EvaluateGradient(list(x[k]), point)
            gradient[k] = point
        return Evaluation(distance, gradient, np.zeros((len(x), 3, 3)))

    @cached_property
    def bounds(self) -> Array:
        """The lowest and the highest coordinates of the surface, (2, 3) [length]."""
        return np.array([self.points.min(axis=0), self.points.max(axis=0)])

    @cached_property
    def diagonal(self) -> float:
        """The diagonal of the surface's bounding box [length]."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))


def check_closed(points: Array, triangles: Triangles, name: str) -> None:
    """Raise BadInput unless triangles are the boundary of a solid, with outward normals.

    Each edge must belong to two triangles, with opposite directions of the edge. The enclosed
    volume must be positive. ``name`` is the surface's name in messages.
    """
    label = f"surface = '{name}': expected a closed surface"
    if len(points) and np.abs(points).max() > LARGEST_NUMBER:
        raise BadInput(f"{label} with coordinates of a size up to {LARGEST_NUMBER:g}")
    if not len(triangles) or not np.isfinite(points).all():
        raise BadInput(f"{label}, found {len(triangles)} triangles of finite size")
    directed = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, shared = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    if np.any(shared != 2):
        raise BadInput(
            f"{label}, whose edges are in two triangles each: {np.sum(shared == 1)} edges are in "
            f"one, {np.sum(shared > 2)} in more than two"
        )
    if len(np.unique(directed, axis=0)) < len(directed):
        raise BadInput(f"{label} with outward normals: neighbours have opposite ones")
    volume = enclosed_volume(points, triangles)
    if not volume > 0:
        raise BadInput(
            f"{label} with outward normals: it is inverted, with a volume of {volume:.3g}"
        )


def enclosed_volume(points: Array, triangles: Triangles) -> float:
    """Return the volume that triangles with outward normals enclose; overlaps count twice."""
    a, b, c = ((points - points.mean(axis=0))[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _vtk(path: Path | None) -> ModuleType:
    """Return the module `vtk_surface`, imported only here; raise BadInput if VTK is missing."""
    try:
        from fem_snh.geometry.shapes import vtk_surface
    except ImportError:
        raise BadInput(
            f"surface = '{path}': expected the package VTK: pip install 'fem_snh[pictures]'"
        ) from None
    return vtk_surface
