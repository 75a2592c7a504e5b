"""Extract surfaces and element edges of a body from the files that dolfinx's VTKFile wrote."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import mutable, vtkObject
from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter

from fem_snh.errors import BadInput
from fem_snh.records.output_fields import CELL_GROUP, SUMMED
from fem_snh.viewing.render.options import ViewOptions
from fem_snh.viewing.render.records import VECTORS, component_index, split_component

#: Largest number of boundary faces with which element edges are drawn.
EDGES_UP_TO = 6000
#: Corners of the reference cells, in the order of VTK.
_TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
_HEXAHEDRON = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
    dtype=float,
)
#: The name of the data that are the numbers of cells.
_CELL = "fem_snh_cell"
#: The field with the smallest J of each cell, which pictures of its means mark.
_LOWEST = "min_J"
#: Range of the smallest J of cells in which a body has no smallest.
_SAME_J = 1e-6
#: Largest displacement of a mode, relative to the diagonal of the body.
_EXAGGERATION = 0.12


def read_file(file: str) -> Any:
    """Return what VTK reads from a file; raise BadInput if it cannot, without VTK's own lines."""
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
    files: list[str],
    field: str | None,
    hidden: Collection[int] = (),
    also: Collection[str] = (),
) -> pv.UnstructuredGrid:
    """Return one grid from the files of all ranks, without ghost cells and duplicate points.

    It has the displacement and one field; for a name such as ``cauchy_stress.xy``, that component
    under this name. With ``field=None`` it has all fields.

    Parameters
    ----------
    files : list of str
        The files of all ranks.
    field : str or None
        The field.
    hidden : collection of int
        Values of ``cell_group`` of the cells that are left out.
    also : collection of str
        Further fields, of those that the files have.

    Raises
    ------
    BadInput
        If a file cannot be read or lacks a field, or all cells are left out.
    """
    pieces = []
    needed = {"displacement"} | ({split_component(field)[0]} if field else set())
    needed |= {CELL_GROUP} if hidden else set()
    kept = {"displacement", field, *also}
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
    """Add the component that ``field`` names as an array of its own."""
    component = component_index(field)
    if component is not None:
        name = split_component(field)[0]
        data = piece.cell_data if name in piece.cell_data else piece.point_data
        data[field] = np.asarray(data[name]).reshape(len(data[name]), -1)[:, component]


def boundary(grid: pv.UnstructuredGrid, level: int) -> pv.PolyData:
    """Return the surface of a grid; each face is divided into 4^level to follow its curvature."""
    surface = vtkDataSetSurfaceFilter()
    surface.SetInputDataObject(grid)
    surface.SetNonlinearSubdivisionLevel(level)
    surface.Update()
    return pv.wrap(surface.GetOutput())


def face_edges(surface: pv.PolyData, faces: int) -> pv.PolyData:
    """Return the element edges of a subdivided surface.

    A line inside a face belongs to two of its triangles, an element edge to one. The surface filter
    writes the triangles of a face one after another, the same number for each face.
    """
    count = surface.n_cells // faces
    return _sides(surface, np.arange(surface.n_cells) // count)


def _sides(surface: pv.PolyData, face: np.ndarray) -> pv.PolyData:
    """Return the sides of triangles that belong to one triangle of their face only.

    ``face`` has the number of the face, or cell, of each triangle.
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

    The field ``mode`` is divided by its largest length, so that all panels share their colours.
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
    """The geometry of one panel and the values of its field.

    ``lowest`` is where the smallest J at a quadrature point is, and its value: the centre of a
    deformed cell, or a point of a skin. It may lie inside of the body. ``extremes`` are the
    smallest and the largest value of the field in the whole body, each with the cell's centre or
    the node at rest.
    """

    surface: pv.PolyData
    edges: pv.PolyData | None
    rest: pv.PolyData
    ghost: pv.PolyData
    values: np.ndarray
    lowest: tuple[np.ndarray, float] | None = None
    extremes: Sequence[tuple[float, list[float]]] = ()


def is_flat(points: np.ndarray) -> bool:
    """Return whether points (n, 3) are those of a mesh of two dimensions: in the plane z = 0."""
    return not np.any(points[:, 2])


#: Angles of a revolved section in a picture [rad]: a quarter is left open, towards the viewer.
_FIRST, _LAST = np.deg2rad(103), np.deg2rad(373)
#: Steps between them.
_STEPS = 72


def revolve(item: DrawnBody, field: str) -> DrawnBody:
    """Return three quarters of the body of revolution of which ``item`` is the section.

    The axis, y in the section, is upright, along z. Displacements out of the section, by torsion,
    turn with it.
    """
    surface = item.surface
    outline = surface.extract_feature_edges(
        boundary_edges=True, feature_edges=False, manifold_edges=False, non_manifold_edges=False
    )
    lines = np.asarray(outline.lines).reshape(-1, 3)[:, 1:]
    off_axis = np.abs(outline.points[:, [0, 2]]).max(axis=1) > 1e-9 * surface.length
    kept = off_axis[lines].any(axis=1)
    side = swept(outline.points, lines[kept])
    if field in outline.cell_data:
        side.cell_data[field] = np.tile(outline.cell_data[field][kept], _STEPS)
    else:
        side.point_data[field] = np.tile(outline.point_data[field], _STEPS + 1)
    whole = pv.merge([side, _caps(surface)], merge_points=False)
    edges = None if item.edges is None else _caps(item.edges)
    lowest = item.lowest and (_turned(item.lowest[0][None], _FIRST)[0], item.lowest[1])
    rest, ghost = _caps(item.rest), _caps(item.ghost)
    return DrawnBody(whole, edges, rest, ghost, item.values, lowest, item.extremes)


def swept(points: np.ndarray, lines: np.ndarray) -> pv.PolyData:
    """Return the surface that lines (m, 2) between points (n, 3) of a section sweep, by angles."""
    angles = np.linspace(_FIRST, _LAST, _STEPS + 1)
    turned = np.concatenate([_turned(points, angle) for angle in angles])
    firsts = len(points) * np.arange(_STEPS)[:, None, None]
    quads = np.concatenate([lines, lines[:, ::-1] + len(points)], axis=1) + firsts
    quads = quads.reshape(-1, 4)
    return pv.PolyData(turned, np.column_stack([np.full(len(quads), 4), quads]).ravel())


def _turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Return points (n, 3) of a section, (r, z, theta), turned about the axis, which is upright."""
    c, s = np.cos(angle), np.sin(angle)
    r, z, t = np.asarray(points).T
    return np.column_stack([c * r - s * t, -s * r - c * t, z])


def _caps(mesh: pv.PolyData) -> pv.PolyData:
    """Return a section at the first and at the last angle."""
    ends = []
    for angle in (_FIRST, _LAST):
        end = mesh.copy()
        end.points = _turned(mesh.points, angle)
        ends.append(end)
    return pv.merge(ends, merge_points=False)


def clip(
    surface: pv.PolyData,
    edges: pv.PolyData | None,
    grid: pv.UnstructuredGrid,
    normal: Sequence[float],
    origin: Sequence[float],
) -> tuple[pv.PolyData, pv.PolyData | None]:
    """Return surface and element edges of the part of a body behind a plane, with its section.

    The section is that of the cells of degree 1 between the nodes.

    Parameters
    ----------
    surface, edges : pyvista.PolyData
        Those of the whole body.
    grid : pyvista.UnstructuredGrid
        The deformed body.
    normal, origin : (3,)
        Normal of the plane, which points to the part that is cut away, and a point of it.

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
    """Return the cells of degree 1 between the nodes of tetrahedra or hexahedra of degree 1 or 2.

    Their data "fem_snh_cell" are the numbers of the cells. VTK loses the data of Lagrange cells
    that it cuts. Cells of two dimensions are returned as they are.
    """
    cell = grid.GetCell(0)
    if cell.GetCellDimension() < 3:
        return grid
    nodes = cell.GetNumberOfPoints()
    is_hexahedron = nodes in (8, 27)
    degree = 1 if nodes in (4, 8) else 2
    corners = (_HEXAHEDRON if is_hexahedron else _TETRAHEDRON) / degree
    if is_hexahedron:
        starts = np.stack(np.meshgrid(*[np.arange(degree) / degree] * 3), axis=-1).reshape(-1, 1, 3)
        parts = starts + corners
    elif degree == 1:
        parts = corners[None]
    else:
        middles = {(i, j): corners[i] + corners[j] for i in range(4) for j in range(i + 1, 4)}
        ring = [middles[edge] for edge in ((0, 2), (0, 3), (1, 3), (1, 2))]
        around = [[middles[0, 1], middles[2, 3], ring[k - 1], ring[k]] for k in range(4)]
        parts = np.array([*(corners + corner for corner in corners), *around])
    local = np.array([[_node_at(cell, point) for point in part] for part in parts])
    connectivity = np.asarray(grid.cell_connectivity).reshape(-1, nodes)[:, local]
    kind = pv.CellType.HEXAHEDRON if is_hexahedron else pv.CellType.TETRA
    fine = pv.UnstructuredGrid({kind: connectivity.reshape(-1, local.shape[1])}, grid.points)
    for name, values in grid.point_data.items():
        fine.point_data[name] = values
    for name, values in grid.cell_data.items():
        fine.cell_data[name] = np.repeat(values, len(local), axis=0)
    fine.cell_data[_CELL] = np.repeat(np.arange(grid.n_cells), len(local))
    return fine


def _node_at(cell: Any, point: np.ndarray) -> int:
    """Return the node of a cell at a point of the reference cell: versions of VTK order them."""
    weights = [0.0] * cell.GetNumberOfPoints()
    cell.EvaluateLocation(mutable(0), point, [0.0] * 3, weights)
    return int(np.argmax(weights))


def body(
    files: list[str], field: str, options: ViewOptions | None = None, revolved: bool = False
) -> DrawnBody:
    """Return the geometry of one load from the files of all ranks, of a section ``revolved``."""
    hidden = options.hidden_cells if options else ()
    grid = read_grid(files, field, hidden, (_LOWEST,) if field == "J" else ())
    if field == "mode":
        exaggerate(grid)
    if not np.all(np.isfinite(grid["displacement"])):
        raise BadInput(f"{files[0]}: the displacement is not finite: choose other loads")
    item = body_of(grid, field, options, turned=revolved or field == "mode")
    return revolve(item, field) if revolved else item


def body_of(
    grid: pv.UnstructuredGrid,
    field: str,
    options: ViewOptions | None = None,
    turned: bool = False,
) -> DrawnBody:
    """Return surface, element edges, outline at rest and values (per cell or point) of a grid.

    With a clip plane among the ``options``, the surface is that of the remaining part. Points of a
    section that torsion moves out of its plane keep their radius in it, unless they stay
    ``turned``.
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
    lowest = _lowest(deformed)
    if options and options.clip:
        origin = options.clip_point or tuple(grid.center)
        surface, edges = clip(surface, edges, deformed, options.clip, origin)
        ghost = ghost.clip(normal=options.clip, origin=origin, invert=True)
        behind = rest.clip(normal=options.clip, origin=origin, invert=True)
        rest = behind if behind.n_cells else rest
        lowest = _lowest(deformed, np.array(options.clip), np.array(origin))
    if not (is_flat(grid.points) and np.any(grid["displacement"][:, 2])):  # no torsion
        surface.point_data[VECTORS] = surface.point_data["displacement"]
    surface[field] = values = _scalars(surface, field)
    return DrawnBody(surface, edges, rest, ghost, values, lowest, _extremes(grid, field))


def _scalars(mesh: Any, field: str) -> np.ndarray:
    """Return the values of a field, of a vector or tensor their magnitudes."""
    values = np.asarray(mesh[field], dtype=float)
    return np.linalg.norm(values, axis=1) if values.ndim == 2 else values


def _extremes(grid: pv.UnstructuredGrid, field: str) -> list[tuple[float, list[float]]]:
    """Return the smallest and the largest finite value of a field, and where they are at rest."""
    values = _scalars(grid, field)
    finite = np.flatnonzero(np.isfinite(values))
    if not len(finite):
        return []
    points = grid.points if field in grid.point_data else grid.cell_centers().points
    chosen = finite[values[finite].argmin()], finite[values[finite].argmax()]
    return [(float(values[i]), np.asarray(points[i], dtype=float).tolist()) for i in chosen]


def _lowest(
    grid: pv.UnstructuredGrid, normal: np.ndarray | None = None, origin: np.ndarray | None = None
) -> tuple[np.ndarray, float] | None:
    """Return where the smallest J of a deformed grid is, and its value; None where J is uniform.

    With a plane, only what is behind it counts.
    """
    if _LOWEST not in grid.array_names:
        return None
    per_cell = _LOWEST in grid.cell_data
    points = np.asarray(grid.cell_centers().points if per_cell else grid.points, dtype=float)
    values = np.asarray(grid[_LOWEST], dtype=float)
    shown = np.isfinite(values)
    if normal is not None:
        shown &= (points - origin) @ normal <= 0
    if not shown.any() or np.ptp(values[shown]) < _SAME_J:
        return None
    number = np.flatnonzero(shown)[values[shown].argmin()]
    return points[number], float(values[number])
