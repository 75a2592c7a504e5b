"""Extract surfaces and element edges of a body from the files that dolfinx's VTKFile wrote."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkIdList, vtkObject, vtkPoints
from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter

from fem_snh.errors import BadInput
from fem_snh.geometry.motions import AffineTable, Motion, PoseTable
from fem_snh.geometry.shapes import ClosedSurface, from_record
from fem_snh.geometry.shapes.triangles import surface_triangles
from fem_snh.records.output_fields import CELL_GROUP, SUMMED
from fem_snh.viewing.stored_run import VECTORS, WHOLE, ViewOptions, component_index, split_component

#: Largest number of boundary faces with which element edges are drawn.
EDGES_UP_TO = 6000
_EDGES_OF_A_TETRAHEDRON = 6
#: Name of the cell data that are the numbers of the cells.
_CELL = "fem_snh_cell"
#: Largest displacement of a mode, relative to the diagonal of the body.
_EXAGGERATION = 0.12
#: Obstacles are cut off at the box of the bodies, enlarged on each side by this part of its
#: diagonal: a plane has no end, and a distant obstacle would make the body small.
_MARGIN = 0.25
#: Points per direction of the grid on which the section of a shape with the plane is computed.
_FLAT_GRID = 400


def read_file(file: str | Path) -> Any:
    """Return the data set in a file, without VTK's warnings; BadInput if it cannot be read."""
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.SetGlobalWarningDisplay(0)
    try:
        reader: Any = pv.get_reader(file)
        found = reader.read()
    except Exception as error:  # VTK's readers document no exceptions
        raise BadInput(f"{file}: cannot be read: {error}") from None
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)
    if reader.reader.GetErrorCode():
        raise BadInput(f"{file}: cannot be read: it is truncated or damaged")
    return found


def read_grid(
    files: Sequence[str | Path],
    field: str | None,
    hidden: Collection[int] = (),
) -> pv.UnstructuredGrid:
    """Return one grid from the files of all ranks, without ghost cells and duplicate points.

    It has the displacement and one field; for a name such as ``cauchy_stress.xy``, that component
    under this name. With ``field=None`` it has all fields. At a point of several ranks, fields of
    `SUMMED` are added, other fields averaged.

    Parameters
    ----------
    files : sequence of path
        The files of all ranks.
    field : str or None
        The field.
    hidden : collection of int
        Values of ``cell_group`` of the cells that are left out.

    Raises
    ------
    BadInput
        If a file cannot be read or lacks a field, or all cells are left out.
    """
    pieces = []
    needed = {"displacement"} | ({split_component(field)[0]} if field else set())
    needed |= {CELL_GROUP} if hidden else set()
    kept = {"displacement", field}
    for file in files:
        piece = read_file(file)
        if not piece.array_names:
            raise BadInput(f"{file}: cannot be read: it is damaged")
        for name in sorted(needed):
            if name not in piece.array_names:
                raise BadInput(f"{file}: has no '{name}', only {', '.join(piece.array_names)}")
        left_out = np.asarray(piece.cell_data.get("vtkGhostType", np.zeros(piece.n_cells))) != 0
        if hidden:
            left_out |= np.isin(piece.cell_data[CELL_GROUP], list(hidden))
        if left_out.any():
            piece = piece.extract_cells(~left_out)
        if not piece.n_cells:
            continue
        if field:
            _select_component(piece, field)
        for name in set(piece.array_names) - kept:
            if field or name.startswith("vtk"):
                piece.point_data.pop(name, None)
                piece.cell_data.pop(name, None)
        pieces.append(piece)
    if not pieces:
        raise BadInput("--hide: nothing of the body is left: expected fewer names")
    if len(pieces) == 1:
        return pieces[0]
    grid: Any = pv.merge(pieces, merge_points=False)
    # Ranks compute shared points with different rounding, so a tolerance is needed.
    merged: Any = grid.clean(tolerance=1e-9 * grid.length)  # averages
    onto = merged.field_data.pop("PointMergeMap")
    for name in grid.point_data.keys():
        if split_component(name)[0] in SUMMED:
            values = np.asarray(grid.point_data[name])
            total = np.zeros((merged.n_points, *values.shape[1:]))
            np.add.at(total, onto, values)
            merged.point_data[name] = total
    return merged


def _select_component(piece: Any, field: str) -> None:
    """Add the component that ``field`` names, if any, to a grid as a separate array."""
    component = component_index(field)
    if component is not None:
        name = split_component(field)[0]
        data = piece.cell_data if name in piece.cell_data else piece.point_data
        data[field] = np.asarray(data[name]).reshape(len(data[name]), -1)[:, component]


def boundary(grid: pv.UnstructuredGrid, level: int) -> pv.PolyData:
    """Return the surface of a grid; each face becomes 4^level faces to follow its curvature."""
    surface = vtkDataSetSurfaceFilter()
    surface.SetInputDataObject(grid)
    surface.SetNonlinearSubdivisionLevel(level)
    surface.Update()
    return pv.wrap(surface.GetOutput())


def face_edges(surface: pv.PolyData, faces: int) -> pv.PolyData:
    """Return the element edges of a surface of ``faces`` faces, each subdivided into triangles.

    A line inside a face belongs to two of its triangles, an element edge to one. The surface filter
    writes the triangles of a face one after another, the same number for each face.
    """
    count = surface.n_cells // faces
    return _sides(surface, np.arange(surface.n_cells) // count)


def _sides(surface: pv.PolyData, face: np.ndarray) -> pv.PolyData:
    """Return the sides of triangles that belong to only one triangle of a face.

    ``face`` (triangles,) is the number of each triangle's face, or cell.
    """
    triangles = surface.regular_faces
    sides = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    )
    keyed = np.column_stack([sides, np.tile(face, 3)])
    once, count = np.unique(keyed, axis=0, return_counts=True)
    lines = np.unique(once[count == 1, :2], axis=0)
    cells = np.column_stack([np.full(len(lines), 2), lines])
    return pv.PolyData(surface.points, lines=cells.ravel())


def exaggerate(grid: pv.UnstructuredGrid) -> None:
    """Replace the rest state by the deformed one, and the displacement by the scaled mode.

    The grid's field ``mode`` is divided by its largest length, so that all panels share their
    colours. BadInput if the mode is zero.
    """
    mode = np.asarray(grid["mode"])
    largest = np.linalg.norm(mode, axis=1).max()
    if not largest > 0:
        raise BadInput("a mode without a shape")
    grid.points = grid.points + grid["displacement"]
    grid["displacement"] = mode * (_EXAGGERATION * grid.length / largest)
    grid["mode"] = mode / largest


@dataclass
class DrawnBody:
    """The geometry of one panel and the values of its field on the surface.

    ``surface`` and element ``edges`` are deformed; ``ghost`` are the sharp edges of the surface at
    ``rest``. ``extremes`` are the smallest and the largest value of the field in the whole body,
    each with the cell's centre or the node at rest.
    """

    surface: pv.PolyData
    edges: pv.PolyData | None
    rest: pv.PolyData
    ghost: pv.PolyData
    values: np.ndarray
    extremes: Sequence[tuple[float, list[float]]] = ()


def is_flat(points: np.ndarray) -> bool:
    """Return whether a mesh with these points (n, 3) is plane: all are in the plane z = 0."""
    return not np.any(points[:, 2])


def clip(
    surface: pv.PolyData,
    edges: pv.PolyData | None,
    grid: pv.UnstructuredGrid,
    normal: Sequence[float],
    origin: Sequence[float],
) -> tuple[pv.PolyData, pv.PolyData | None]:
    """Return surface and element edges of the part of a body behind a plane, with its section.

    The section is computed from linear tetrahedra between the nodes.

    Parameters
    ----------
    surface, edges : pyvista.PolyData
        Surface and element edges (or None) of the whole deformed body.
    grid : pyvista.UnstructuredGrid
        The deformed body.
    normal : (3,)
        Normal of the plane, which points to the part that is cut away.
    origin : (3,)
        A point of the plane.

    Raises
    ------
    BadInput
        If nothing of the body is left.
    """
    plane = {"normal": list(normal), "origin": list(origin)}
    kept: Any = surface.clip(invert=True, **plane)
    if not kept.n_cells:
        raise BadInput(f"--clip: nothing of the body is behind the plane at {list(origin)}")
    outline = edges.clip(invert=True, **plane) if edges is not None else None
    section: Any = linear_cells(grid).slice(generate_triangles=True, **plane)
    if len(section.faces):  # a skin or a body of two dimensions has a line in place of it
        if outline is not None:
            cuts = _sides(section, np.asarray(section.cell_data[_CELL]))
            outline = pv.merge([outline, cuts], merge_points=False)
        del section.cell_data[_CELL]
        kept = pv.merge([kept, section], merge_points=False)
    return kept, outline


def linear_cells(grid: pv.UnstructuredGrid) -> pv.UnstructuredGrid:
    """Return the simplices between the nodes of a grid.

    Their data "fem_snh_cell" are the numbers of the grid's cells. VTK loses the data of Lagrange
    cells that it cuts.
    """
    grid = grid.copy(deep=False)
    grid.cell_data[_CELL] = np.arange(grid.n_cells)
    cell = grid.GetCell(0)
    if cell.GetNumberOfEdges() != _EDGES_OF_A_TETRAHEDRON:
        return grid.triangulate()
    nodes = vtkIdList()  # VTK's filter leaves gaps between tetrahedra of degree 2
    cell.Triangulate(0, nodes, vtkPoints())
    number = {cell.GetPointId(i): i for i in range(cell.GetNumberOfPoints())}
    local = np.array([number[nodes.GetId(i)] for i in range(nodes.GetNumberOfIds())]).reshape(-1, 4)
    connectivity = np.asarray(grid.cell_connectivity).reshape(grid.n_cells, -1)[:, local]
    fine = pv.UnstructuredGrid({pv.CellType.TETRA: connectivity.reshape(-1, 4)}, grid.points)
    fine.point_data.update(grid.point_data)
    owner = np.repeat(np.arange(grid.n_cells), len(local))
    fine.cell_data.update({name: values[owner] for name, values in grid.cell_data.items()})
    return fine


def body(
    files: Sequence[str | Path],
    field: str,
    options: ViewOptions = WHOLE,
) -> DrawnBody:
    """Return the geometry of one state from the files of all ranks.

    BadInput if the displacement is not finite.
    """
    grid = read_grid(files, field, options.hidden_cells)
    if field == "mode":
        exaggerate(grid)
    if not np.all(np.isfinite(grid["displacement"])):
        raise BadInput(f"{files[0]}: the displacement is not finite: choose other loads")
    return body_of(grid, field, options, turned=field == "mode")


def body_of(
    grid: pv.UnstructuredGrid,
    field: str,
    options: ViewOptions = WHOLE,
    turned: bool = False,
) -> DrawnBody:
    """Return the geometry of a grid and the values of a field, per cell or point of its surface.

    With a clip plane among the ``options``, the surface is that of the remaining part. Torsion
    moves points of an axisymmetric section out of its plane; they are turned back into it at their
    radius, unless they are to stay ``turned``.
    """
    faces = boundary(grid, 0).n_cells
    level = 3 if faces < 1500 else 2 if faces < 10_000 else 1 if faces < 50_000 else 0
    rest = boundary(grid, min(level, 1))
    deformed = grid.warp_by_vector("displacement")
    if is_flat(grid.points) and not turned:
        r, z, t = np.asarray(deformed.points).T
        deformed.points = np.column_stack([np.where(t == 0, r, np.hypot(r, t)), z, 0 * t])
    surface = boundary(deformed, level)
    # The edges of a skin are no element's.
    is_skin = set(grid.celltypes) == {pv.CellType.TRIANGLE} and not is_flat(grid.points)
    edges = face_edges(surface, faces) if faces <= EDGES_UP_TO and not is_skin else None
    ghost = rest.extract_feature_edges(
        feature_angle=35, manifold_edges=False, non_manifold_edges=False
    )
    if options.clip:
        origin = options.clip_point or tuple(grid.center)
        surface, edges = clip(surface, edges, deformed, options.clip, origin)
        ghost = ghost.clip(normal=options.clip, origin=origin, invert=True)
        behind = rest.clip(normal=options.clip, origin=origin, invert=True)
        rest = behind if behind.n_cells else rest
    if not (is_flat(grid.points) and np.any(grid["displacement"][:, 2])):  # no torsion
        surface.point_data[VECTORS] = surface.point_data["displacement"]
    surface[field] = values = _scalars(surface, field)
    return DrawnBody(surface, edges, rest, ghost, values, _extremes(grid, field))


def _scalars(mesh: Any, field: str) -> np.ndarray:
    """Return the values of a scalar field, or the magnitudes of a vector or tensor field."""
    values = np.asarray(mesh[field], dtype=float)
    return np.linalg.norm(values, axis=1) if values.ndim == 2 else values


def _extremes(grid: pv.UnstructuredGrid, field: str) -> list[tuple[float, list[float]]]:
    """Return the smallest and the largest finite value of a field, each with its point at rest."""
    values = _scalars(grid, field)
    finite = np.flatnonzero(np.isfinite(values))
    if not len(finite):
        return []
    points = grid.points if field in grid.point_data else grid.cell_centers().points
    chosen = finite[values[finite].argmin()], finite[values[finite].argmax()]
    return [(float(values[i]), np.asarray(points[i], dtype=float).tolist()) for i in chosen]


class Obstacles:
    """The obstacles, bones and rigid shapes of a run, as `obstacle_poses` returns them.

    Parameters
    ----------
    records : sequence of dict
        ``kind``, "obstacles", "bones" or "rigid"; ``shape``, a table of one key; ``loads``;
        ``poses``, at each load the rows [R | c], interpolated by slerp, or [A | c] of a bone.
    flat : bool
        Whether the bodies are in the plane z = 0. The solids are then replaced by their sections
        with this plane, as the sides of a prism cannot be seen along z.
    """

    def __init__(self, records: Sequence[dict[str, Any]], flat: bool = False) -> None:
        self._items: list[tuple[str, str, Any, Motion]] = []
        self._flat = flat
        for record in records:
            poses, loads = np.array(record["poses"], dtype=float), np.array(record["loads"])
            motion: Motion = AffineTable(loads, poses)
            kind = record.get("kind", "obstacles")
            if kind != "bones":
                motion = PoseTable(loads, poses[:, :, :3], poses[:, :, 3])
            self._items.append((kind, *next(iter(record["shape"].items())), motion))

    def at(self, load: float, bounds: np.ndarray) -> list[tuple[str, pv.PolyData]]:
        """Return (kind, surface) of the solids at a load, cut off at a box around the bodies.

        Parameters
        ----------
        load : float
            The load or time.
        bounds : (2, 3) array
            Lowest and highest coordinates of the bodies in all panels [length].
        """
        margin = _MARGIN * np.linalg.norm(bounds[1] - bounds[0])
        box = np.array([bounds[0] - margin, bounds[1] + margin])
        found = []
        for kind, shape, keys, motion in self._items:
            matrix = np.eye(4)
            matrix[:3] = motion.affine(load)
            draw = _section if self._flat else _surface
            surface = draw(shape, keys, matrix, box)
            if surface.n_cells:
                found.append((kind, surface))
        return found


def _surface(shape: str, keys: Any, matrix: np.ndarray, box: np.ndarray) -> pv.PolyData:
    """Return the part in a box (2, 3) of a shape's surface at a pose (4, 4)."""
    # The box in the shape's own coordinates: centre and radius.
    inverse = np.linalg.inv(matrix[:3, :3])
    centre = inverse @ (box.mean(axis=0) - matrix[:3, 3])
    radius = float(np.linalg.norm(box[1] - box[0]) * np.linalg.norm(inverse, 2)) / 2
    surface: Any = triangles(shape, keys, centre, radius)
    surface.transform(matrix, inplace=True)
    return boundary(surface.clip_box(list(box.T.ravel()), invert=False), 0)


def _section(shape: str, keys: Any, matrix: np.ndarray, box: np.ndarray) -> pv.PolyData:
    """Return the part in a box (2, 3) of a shape's section by z = 0 at a pose (4, 4)."""
    solid = ClosedSurface.read(keys) if shape == "surface" else from_record({shape: keys})
    low, high = box[:, :2]
    grid = pv.ImageData(
        dimensions=(_FLAT_GRID, _FLAT_GRID, 1),
        spacing=(*(high - low) / (_FLAT_GRID - 1), 1.0),
        origin=(*low, 0.0),
    )
    x = np.asarray(grid.points, dtype=float) - matrix[:3, 3]
    grid["distance"] = solid.distance(x @ np.linalg.inv(matrix[:3, :3]).T)
    inside: Any = grid.clip_scalar(scalars="distance", value=0.0)
    return boundary(inside, 0)


def triangles(kind: str, keys: Any, centre: np.ndarray, radius: float) -> pv.PolyData:
    """Return the surface of a shape at its reference position.

    Parameters
    ----------
    kind : str
        The key of the shape in a scene.
    keys : dict or str
        The values of the shape; for ``surface`` the path of an STL file.
    centre, radius : (3,) array, float
        A ball [length] around the visible region, where unbounded surfaces are cut off.

    Raises
    ------
    BadInput
        For a file that cannot be read.
    """
    if kind == "surface":
        return read_file(keys)
    found = surface_triangles(from_record({kind: keys}), centre, radius)
    return pv.PolyData.from_regular_faces(*found)
