"""Write the states of a run: OBJ files of the surface, or one VTKHDF file.

`fem_snh.viewing.export.main` calls these functions in a process of its own, as h5py fails to import
after dolfinx, which loads another HDF5 library. They raise BadInput if a state cannot be read or a
file cannot be written.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyvista as pv

from fem_snh.arrays import Array
from fem_snh.errors import BadInput
from fem_snh.files import read_text, replace_file
from fem_snh.viewing import ignore
from fem_snh.viewing.export import obj_path
from fem_snh.viewing.render.surfaces import boundary
from fem_snh.viewing.states import ExportedState, States

#: Subdivision level: each face of a quadratic cell becomes the triangles between its nodes.
_LEVEL = 1
#: Version of the VTKHDF specification; 2.2 is the first that allows groups beside VTKHDF.
VERSION = (2, 2)


#: Called with the number of states written and the number of all states.
Report = Callable[[int, int], object]


def surface_of(mesh: pv.UnstructuredGrid) -> tuple[Array, Array]:
    """Return the nodes and triangles of a mesh's surface.

    Returns
    -------
    nodes : (n,)
        Indices of the nodes on the surface.
    triangles : (m, 3)
        Indices into ``nodes``, counterclockwise seen from outside.
    """
    grid = pv.UnstructuredGrid(mesh)
    grid.point_data["node"] = np.arange(grid.n_points)
    surface = boundary(grid, _LEVEL).triangulate()
    oriented = surface.compute_normals(
        point_normals=False, split_vertices=False, consistent_normals=True, auto_orient_normals=True
    )
    return np.asarray(oriented["node"]), np.asarray(oriented.regular_faces)


def write_obj(out: Path, pvd: Path, report: Report = ignore) -> None:
    """Write the surface at the stored loads as the files of `obj_path`.

    All files have the same vertices, the nodes on the surface, and the same triangles, with normals
    outwards. One state at a time is in memory.

    Parameters
    ----------
    out : Path
        ``NAME.obj``.
    pvd : Path
        The collection of the states.

    Raises
    ------
    BadInput
        If a file of an earlier, longer sequence exists, or a state is not finite.
    """
    states = States(pvd)
    count = len(states)
    paths = [obj_path(out, number) for number in range(count)]
    later = [path for path in out.parent.glob(f"{out.stem}_*.obj") if _is_later(path, out, count)]
    if later:
        raise BadInput(
            f"{min(later)}: of an earlier, longer sequence: remove it or choose another name"
        )
    nodes, triangles = surface_of(states.mesh)
    faces = io.BytesIO()
    np.savetxt(faces, triangles + 1, fmt="f %d %d %d")  # OBJ counts from 1
    rest = states.mesh.points[nodes]
    for number, (path, load) in enumerate(zip(paths, states.loads, strict=True)):
        text = io.BytesIO()
        deformed = rest + states.displacement(number)[nodes]
        np.savetxt(text, deformed, fmt="v %.10g %.10g %.10g", header=f"load {load:.10g}")
        replace_file(path, (text.getvalue() + faces.getvalue()).decode())
        report(number + 1, count)


def _is_later(path: Path, out: Path, count: int) -> bool:
    """Return whether a path is that of the sequence's file ``count``, or of a later one."""
    number = re.fullmatch(rf"{re.escape(out.stem)}_(\d{{4,}})", path.stem)
    return number is not None and int(number[1]) >= count


def write_vtkhdf(out: Path, pvd: Path, report: Report = ignore) -> None:
    """Write all states into one file: a temporal unstructured grid, with the load as its time.

    The mesh is written once, as one part. An array per field holds the values of all states one
    after another, and ``Steps`` their offsets. One state at a time is in memory.

    Parameters
    ----------
    out : Path
        The file; at the end it replaces an earlier one.
    pvd : Path
        The collection of the states.

    Notes
    -----
    The file also holds the run's run.json, as the text ``/fem_snh/run.json``, which VTK ignores.

    References
    ----------
    Kitware, *VTKHDF format specification*, version 2:
    https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/vtkhdf_specifications.html
    """
    import h5py

    states = States(pvd)

    def write(file: BinaryIO) -> None:
        with h5py.File(file, "w") as hdf:
            root = hdf.create_group("VTKHDF")
            root.attrs["Version"] = VERSION
            # The reader expects a string of fixed length.
            root.attrs.create("Type", np.bytes_("UnstructuredGrid"))
            _write_mesh(root, states)
            _write_steps(root, states)
            for number in range(len(states)):
                _write_state(root, states.read(number), number, len(states))
                report(number + 1, len(states))
            hdf.create_dataset("fem_snh/run.json", data=read_text(pvd.with_name("run.json")))

    replace_file(out, write)


def _write_mesh(root: Any, states: States) -> None:
    """Write the reference points [m] and the cells into the group VTKHDF."""
    mesh = states.mesh
    root["NumberOfPoints"] = np.array([mesh.n_points])
    root["NumberOfCells"] = np.array([mesh.n_cells])
    root["NumberOfConnectivityIds"] = np.array([len(mesh.cell_connectivity)])
    root["Points"] = mesh.points
    root["Connectivity"] = np.asarray(mesh.cell_connectivity, dtype=np.int64)
    offsets = pv.convert_array(mesh.GetCells().GetOffsetsArray())
    root["Offsets"] = np.asarray(offsets, dtype=np.int64)
    root["Types"] = np.asarray(mesh.celltypes, dtype=np.uint8)


def _write_steps(root: Any, states: States) -> None:
    """Write the loads, and offsets of zero into the mesh, which all steps share."""
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = len(states)
    steps["Values"] = np.array(states.loads)
    steps["NumberOfParts"] = np.ones(len(states), dtype=np.int64)
    for name in ("PartOffsets", "PointOffsets"):
        steps[name] = np.zeros(len(states), dtype=np.int64)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        steps[name] = np.zeros((len(states), 1), dtype=np.int64)


def _write_state(root: Any, state: ExportedState, number: int, count: int) -> None:
    """Write the fields of state ``number``; state 0 creates the arrays for all ``count`` states."""
    for place, fields in (("PointData", state.point_data), ("CellData", state.cell_data)):
        for name, values in fields.items():
            rows = len(values)
            if number == 0:
                offsets = root.require_group(f"Steps/{place}Offsets")
                offsets[name] = rows * np.arange(count)
                shape = (rows * count, *values.shape[1:])
                root.require_group(place).create_dataset(name, shape, values.dtype)
            root[place][name][rows * number : rows * (number + 1)] = values
