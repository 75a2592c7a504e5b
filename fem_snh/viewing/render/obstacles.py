"""Draw the obstacles and the bones of a run: triangles of their shapes, at their poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkFiltersGeneral import vtkContourTriangulator

from fem_snh.geometry.motions import AffineTable, Motion, PoseTable
from fem_snh.geometry.shapes import ClosedSurface, Shape, from_record
from fem_snh.geometry.shapes.triangles import surface_triangles
from fem_snh.viewing.render.surfaces import boundary, read_file, swept

#: Colour and opacity of obstacles and of bones; a body must be translucent to show its bones.
STYLES = {"obstacles": ("#a0a0a0", 0.35), **dict.fromkeys(("bones", "rigid"), ("#e3d9bf", 1.0))}
#: The name of a surface's data that is its kind.
_KIND = "kind"
#: Obstacles are cut off at the box of the bodies, enlarged on each side by this part of its
#: diagonal: a plane has no end, and a distant obstacle would make the body small.
_MARGIN = 0.25
#: Half of the thickness that is kept of obstacles whose section is revolved, over the radius.
_THIN = 0.01
#: Points along an edge of the grid of sections by the plane of the body, and the distance of the
#: edge from what is filled, over the size of the picture.
_FLAT_GRID, _ROUNDING = 400, 1e-6


class Obstacles:
    """The obstacles and the bones of a run, as `fem_snh.viewing.render.records.obstacle_poses` has
    them.

    Parameters
    ----------
    records : sequence of dict
        ``kind``, a key of `STYLES`; ``shape``, a table of one key; ``loads``; ``poses``, at each
        load the rows [R | c], which are slerped, or [A | c] of a bone.
    revolved : bool
        Whether the obstacles of a section are drawn as bodies of revolution, as the body is.
    flat : bool
        Whether the bodies are in the plane z = 0: of the obstacles it is their section by it, as
        the sides of a prism are not seen along z.
    """

    def __init__(
        self, records: Sequence[dict[str, Any]], revolved: bool = False, flat: bool = False
    ) -> None:
        self._items, self._revolved, self._flat = [], revolved, flat and not revolved
        for record in records:
            poses = np.array(record["poses"], dtype=float)
            loads, drawn_as = np.array(record["loads"]), record.get("kind", "obstacles")
            motion: Motion = AffineTable(loads, poses)
            if drawn_as != "bones":
                motion = PoseTable(loads, poses[:, :, :3], poses[:, :, 3])
            ((kind, keys),) = record["shape"].items()
            self._items.append((kind, keys, motion, drawn_as))

    def at(self, load: float, bounds: np.ndarray) -> list[pv.PolyData]:
        """Return the surfaces at a load, as far as they are near the bodies.

        Parameters
        ----------
        load : float
            The load, from 0 to 1.
        bounds : (2, 3) array
            Lowest and highest coordinates of the bodies in all panels [length].
        """
        margin = _MARGIN * np.linalg.norm(bounds[1] - bounds[0])
        box = np.array([bounds[0] - margin, bounds[1] + margin])
        if self._revolved:  # of the section: the radius, and the axis, which is upright
            outer = np.abs(bounds[:, :2]).max() + margin
            thin = _THIN * outer
            box = np.array([[0.0, box[0, 2], -thin], [outer, box[1, 2], thin]])
        found = []
        for kind, keys, motion, drawn_as in self._items:
            matrix = np.eye(4)
            matrix[:3] = motion.affine(load)
            if self._flat:
                shape = ClosedSurface.read(keys) if kind == "surface" else from_record({kind: keys})
                if (section := _section(shape, matrix, box)).n_cells:
                    found.append(section)
                    found[-1].add_field_data([drawn_as], _KIND)
                continue
            # The box in the shape's own coordinates: centre and radius.
            inverse = np.linalg.inv(matrix[:3, :3])
            centre = inverse @ (box.mean(axis=0) - matrix[:3, 3])
            radius = float(np.linalg.norm(box[1] - box[0]) * np.linalg.norm(inverse, 2)) / 2
            surface: Any = triangles(kind, keys, centre, radius)
            surface.transform(matrix, inplace=True)
            cut = surface.clip_box(list(box.T.ravel()), invert=False)
            if cut.n_cells and self._revolved:
                cut = _swept_section(cut)
            if cut.n_cells:
                found.append(boundary(cut, 0))
                found[-1].add_field_data([drawn_as], _KIND)
        return found


def _swept_section(surface: Any) -> pv.PolyData:
    """Return what the section of a surface by the plane z = 0 sweeps about the axis y."""
    # Beside the plane, in which faces and corners may be.
    beside = 1e-6 * surface.length
    section: Any = surface.slice(normal="z", origin=(0, 0, beside))
    if not section.n_cells:
        return pv.PolyData()
    lines = np.asarray(section.lines).reshape(-1, 3)[:, 1:]
    return swept(np.asarray(section.points) * (1.0, 1.0, 0.0), lines)


def _section(shape: Shape, matrix: np.ndarray, box: np.ndarray) -> pv.PolyData:
    """Return the part of a shape at a pose that is in the plane z = 0 and in a box."""
    low, high = box[:, :2]
    grid = pv.ImageData(
        dimensions=(_FLAT_GRID, _FLAT_GRID, 1),
        spacing=(*(high - low) / (_FLAT_GRID - 1), 1.0),
        origin=(*low, 0.0),
    )
    x = np.asarray(grid.points, dtype=float) - matrix[:3, 3]
    distance = shape.distance(x @ np.linalg.inv(matrix[:3, :3]).T).reshape(_FLAT_GRID, -1)
    # Outside of the shape along the edge of the box, where the outline closes.
    outside = np.ones_like(distance, dtype=bool)
    outside[1:-1, 1:-1] = False
    spacing = _ROUNDING * np.linalg.norm(high - low)
    distance[outside] = np.maximum(distance[outside], spacing)
    grid["distance"] = distance.ravel()
    outline = grid.contour([0.0], scalars="distance")
    filled = vtkContourTriangulator()
    filled.SetInputData(outline)
    filled.Update()
    return pv.wrap(filled.GetOutput())


def kind_of(surface: pv.PolyData) -> str:
    """Return the kind of a surface of `Obstacles`, a key of `STYLES`."""
    return str(surface.field_data[_KIND][0])


def triangles(kind: str, keys: Any, centre: np.ndarray, radius: float) -> pv.PolyData:
    """Return the surface of a shape at its reference position.

    Parameters
    ----------
    kind : str
        The key of the shape in a scene.
    keys : dict or str
        Its values; of ``surface`` the path of an STL file.
    centre, radius : (3,) array, float
        A ball that holds all that is shown [length]: surfaces without an end are cut off there.

    Raises
    ------
    BadInput
        For a file that cannot be read.
    """
    if kind == "surface":
        return read_file(keys)
    found = surface_triangles(from_record({kind: keys}), centre, radius)
    return pv.PolyData.from_regular_faces(*found)
