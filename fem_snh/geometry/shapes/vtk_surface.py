"""The use of VTK for closed surfaces: signed distances, and reading STL and OBJ files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkObject, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance, vtkTriangleFilter
from vtkmodules.vtkIOGeometry import vtkOBJReader, vtkSTLReader

from fem_snh.arrays import Array
from fem_snh.errors import BadInput


def distance_function(corners: Array, triangles: Array) -> Any:
    """Return VTK's signed distance function of triangles (m, 3) int with corners (n, 3)."""
    points, cells, surface = vtkPoints(), vtkCellArray(), vtkPolyData()
    points.SetData(numpy_to_vtk(corners, deep=True))
    cells.SetData(3, numpy_to_vtkIdTypeArray(triangles.ravel(), deep=True))
    surface.SetPoints(points)
    surface.SetPolys(cells)
    function = vtkImplicitPolyDataDistance()
    function.SetInput(surface)
    return function


def distances(function: Any, x: Array) -> Array:
    """Return the values (n,) of a `distance_function` at points x (n, 3)."""
    found = vtkDoubleArray()
    function.FunctionValue(numpy_to_vtk(np.ascontiguousarray(x, dtype=float)), found)
    return np.array(vtk_to_numpy(found))


def read_corners(path: Path) -> Array:
    """Return the corners (m, 3, 3) of the triangles of a file; polygons become triangles.

    Raises
    ------
    BadInput
        For a file without faces of positive area, or with faces that refer to missing points.
    """
    is_obj = path.suffix.lower() == ".obj"
    vtkObject.SetGlobalWarningDisplay(0)  # VTK prints several lines; the messages below are one
    reader: Any = vtkOBJReader() if is_obj else vtkSTLReader()
    reader.SetFileName(str(path))
    reader.Update()
    surface = reader.GetOutput()
    kind = "OBJ file with faces" if is_obj else "STL file with triangles"
    if not surface.GetNumberOfPolys():
        raise BadInput(f"surface = '{path}': expected an {kind}, found none")
    count = surface.GetNumberOfPoints()
    used = vtk_to_numpy(surface.GetPolys().GetConnectivityArray())
    if not len(used) or used.min() < 0 or used.max() >= count:
        raise BadInput(f"surface = '{path}': expected faces of its {count} points")
    triangulated = vtkTriangleFilter()
    triangulated.SetInputData(surface)
    triangulated.Update()
    polygons = triangulated.GetOutput().GetPolys()
    if not polygons.GetNumberOfCells():
        raise BadInput(f"surface = '{path}': expected an {kind}, found none with an area")
    points = vtk_to_numpy(surface.GetPoints().GetData()).astype(float)
    corners: Array = points[vtk_to_numpy(polygons.GetConnectivityArray()).reshape(-1, 3)]
    return np.ascontiguousarray(corners)
