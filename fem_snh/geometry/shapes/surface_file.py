"""Read the triangles of an STL or OBJ file by VTK, which may crash on a damaged one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.geometry.shapes.shape import Array

#: The message without VTK.
NO_VTK = "surface = '{}': expected the package VTK: pip install 'fem_snh[pictures]'"


def read_corners(path: Path) -> Array:
    """Return the corners (m, 3, 3) of the triangles of a file; polygons become triangles.

    Raises
    ------
    BadInput
        Without VTK, and for a file without triangles or whose faces have corners that it has not.
    """
    try:
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkCommonCore import vtkObject
        from vtkmodules.vtkFiltersCore import vtkTriangleFilter
        from vtkmodules.vtkIOGeometry import vtkOBJReader, vtkSTLReader
    except ImportError:
        raise BadInput(NO_VTK.format(path)) from None
    is_obj = path.suffix.lower() == ".obj"
    vtkObject.SetGlobalWarningDisplay(0)  # VTK prints several lines; the messages below are one
    reader: Any = vtkOBJReader() if is_obj else vtkSTLReader()
    reader.SetFileName(str(path))
    reader.Update()
    surface = reader.GetOutput()
    kind = "OBJ file with faces" if is_obj else "STL file with triangles"
    if not surface.GetNumberOfPolys():
        raise BadInput(f"surface = '{path}': expected an {kind}, found none")
    count, used = (
        surface.GetNumberOfPoints(),
        vtk_to_numpy(surface.GetPolys().GetConnectivityArray()),
    )
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
