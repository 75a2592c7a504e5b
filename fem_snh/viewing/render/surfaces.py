"""Extract surfaces and element edges of a body from the files that dolfinx's VTKFile wrote."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter

from fem_snh.errors import BadInput
from fem_snh.output_fields import SUMMED
from fem_snh.viewing.render.fields import component_index, split_component

#: Largest number of boundary faces with which element edges are drawn.
EDGES_UP_TO = 6000
#: Largest displacement of a mode, relative to the diagonal of the body.
_EXAGGERATION = 0.12


def read_grid(files: list[str], field: str | None) -> pv.UnstructuredGrid:
    """Return one grid from the files of all ranks, without ghost cells and duplicate points.

    It has the displacement and one field; for a name such as ``cauchy_stress.xy``, that component
    under this name. With ``field=None`` it has all fields.
    """
    pieces = []
    needed = {"displacement"} | ({split_component(field)[0]} if field else set())
    for file in files:
        try:
            piece: Any = pv.read(file)
        except Exception as error:  # VTK's readers document no exceptions
            raise BadInput(f"{file}: cannot be read: {error}") from None
        for name in sorted(needed):
            if name not in piece.array_names:
                raise BadInput(f"{file}: has no '{name}', only {', '.join(piece.array_names)}")
        ghost = piece.cell_data.get("vtkGhostType")
        if ghost is not None and np.any(ghost):
            piece = piece.extract_cells(np.asarray(ghost) == 0)
        if field:
            _select_component(piece, field)
        for name in set(piece.array_names) - {"displacement", field}:
            if field or name.startswith("vtk"):
                piece.point_data.pop(name, None)
                piece.cell_data.pop(name, None)
        pieces.append(piece)
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
    triangles = surface.regular_faces
    face = np.arange(len(triangles)) // (len(triangles) // faces)
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
    """The geometry of one panel and the values of its field."""

    surface: pv.PolyData
    edges: pv.PolyData | None
    rest: pv.PolyData
    ghost: pv.PolyData
    values: np.ndarray


def body(files: list[str], field: str) -> DrawnBody:
    """Return the geometry of one load from the files of all ranks."""
    grid = read_grid(files, field)
    if field == "mode":
        exaggerate(grid)
    if not np.all(np.isfinite(grid["displacement"])):
        raise BadInput(f"{files[0]}: the displacement is not finite: choose other loads")
    return body_of(grid, field)


def body_of(grid: pv.UnstructuredGrid, field: str) -> DrawnBody:
    """Return surface, element edges, outline at rest and values (per cell or point) of a grid."""
    faces = boundary(grid, 0).n_cells
    level = 3 if faces < 1500 else 2 if faces < 10_000 else 1 if faces < 50_000 else 0
    rest = boundary(grid, min(level, 1))
    surface = boundary(grid.warp_by_vector("displacement"), level)
    is_skin = set(grid.celltypes) == {pv.CellType.TRIANGLE}  # its edges are no element's
    edges = face_edges(surface, faces) if faces <= EDGES_UP_TO and not is_skin else None
    ghost = rest.extract_feature_edges(
        feature_angle=35, manifold_edges=False, non_manifold_edges=False
    )
    values = np.asarray(surface[field], dtype=float)
    if values.ndim == 2:
        values = np.linalg.norm(values, axis=1)
    surface[field] = values
    return DrawnBody(surface, edges, rest, ghost, values)
