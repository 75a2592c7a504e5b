"""The deformed surface of a run as a sequence of Wavefront OBJ files."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyvista as pv
from scipy.interpolate import PchipInterpolator

from fem_snh.atomic_files import replace_file
from fem_snh.errors import BadInput
from fem_snh.viewing.render.surfaces import boundary
from fem_snh.viewing.states import States, SurfaceFields

#: Divides each face of a quadratic cell into the triangles between its nodes.
_LEVEL = 1


def write_sequence(
    out: Path,
    states: States,
    frames: int | None = None,
    report: Callable[[int, int], None] | None = None,
    field: str | None = None,
) -> list[Path]:
    """Write ``NAME_0000.obj``, ``NAME_0001.obj``, ... and return their paths.

    All files have the same triangles of the same vertices, the nodes on the surface, with normals
    outwards. One state at a time is in memory, and of interpolated ones the surface.

    Parameters
    ----------
    out : Path
        ``NAME.obj``.
    states : States
        The states.
    frames : int, optional
        Number of files, evenly spaced over the load; default: one for each stored load.
    report : callable, optional
        Called with the numbers of files written and of all files.
    field : str, optional
        A field that colours the vertices: red, green and blue (sRGB, 0 to 1) after the coordinates.

    Raises
    ------
    BadInput
        If a state cannot be read, a file cannot be written, frames are to be interpolated from
        one state, or there are files of an earlier, longer sequence.
    """
    count = frames or len(states)
    if frames and len(states) < 2:
        raise BadInput(f"--frames {frames}: needs two stored loads or more: found {len(states)}")
    paths = [_path(out, number) for number in range(count)]
    later = [path for path in out.parent.glob(f"{out.stem}_*.obj") if _is_later(path, out, count)]
    if later:
        raise BadInput(
            f"{min(later)}: of an earlier, longer sequence: remove it or choose another name"
        )
    nodes, triangles = surface_of(states.mesh)
    faces = io.BytesIO()
    np.savetxt(faces, triangles + 1, fmt="f %d %d %d")  # OBJ counts from 1
    rest = states.mesh.points[nodes]
    fields = SurfaceFields(states, nodes) if field else None
    colours = fields.colours(str(field)) if fields else None
    form = " ".join(["v", *["%.10g"] * 3, *["%.4f"] * (3 if colours else 0)])

    def stored() -> Iterator[tuple[float, np.ndarray]]:
        """Yield load and displacement at the nodes, and the field if any, for each state."""
        for number, load in enumerate(states.loads):
            u = states.displacement(number)[nodes]
            yield load, np.column_stack([u, fields.scalar(number, str(field))]) if fields else u

    frame = _interpolated(states.loads, stored(), frames) if frames else stored()
    for number, (path, (load, values)) in enumerate(zip(paths, frame, strict=True), 1):
        text = io.BytesIO()
        x = rest + values[:, :3]
        rows = np.column_stack([x, colours(values[:, 3])]) if colours else x
        np.savetxt(text, rows, fmt=form, header=f"load {load:.10g}")
        replace_file(path, (text.getvalue() + faces.getvalue()).decode())
        if report:
            report(number, count)
    return paths


def surface_of(mesh: pv.UnstructuredGrid) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface of a mesh.

    Returns
    -------
    nodes : (n,)
        The nodes on the surface.
    triangles : (m, 3)
        Indices into ``nodes``, in mathematically positive order seen from outside.
    """
    grid = pv.UnstructuredGrid(mesh)
    grid.point_data["node"] = np.arange(grid.n_points)
    surface = boundary(grid, _LEVEL).triangulate()
    oriented = surface.compute_normals(
        point_normals=False, split_vertices=False, consistent_normals=True, auto_orient_normals=True
    )
    return np.asarray(oriented["node"]), np.asarray(oriented.regular_faces)


def _interpolated(
    loads: list[float], stored: Iterator[tuple[float, np.ndarray]], frames: int
) -> Iterator[tuple[float, np.ndarray]]:
    """Yield load and values at the nodes, at evenly spaced loads."""
    values_at = PchipInterpolator(loads, np.array([values for _, values in stored]))
    for load in np.linspace(loads[0], loads[-1], frames):
        yield float(load), values_at(load)


def _path(out: Path, number: int) -> Path:
    return out.with_name(f"{out.stem}_{number:04}{out.suffix}")


def _is_later(path: Path, out: Path, count: int) -> bool:
    """Whether a file has the name of a file of the sequence beyond the last one."""
    number = re.fullmatch(rf"{re.escape(out.stem)}_(\d{{4,}})", path.stem)
    return number is not None and int(number[1]) >= count
