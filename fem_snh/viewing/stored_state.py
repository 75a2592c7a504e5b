"""The displacement of a stored state of a run at points of its reference body."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fem_snh.errors import BadInput, bad_value
from fem_snh.run_record import load_record
from fem_snh.viewing.states import States

Array = npt.NDArray[np.float64]

#: Distance up to which a point is a node of the mesh, over the body's diagonal: for rounding.
_SAME_POINT = 1e-9
#: Largest distance from the mesh, over the body's diagonal, at which a point belongs to the body:
#: two meshes of one curved surface differ by less, unless an element spans a radian.
_LARGEST_DISTANCE = 0.05

#: Number of cells, by the distance of their centres, among which that closest to a point outside
#: of the mesh is found: more than those around a node of hexahedra, or tetrahedra of good shape.
_CANDIDATES = 32
#: Edges of a triangle and of a tetrahedron.
_EDGES_OF_SIMPLICES = (3, 6)


def displacement_at(
    run: Path, step: int, kinematics: str | None, points: Array
) -> tuple[Array, Array]:
    """Return the displacement of a stored state at points.

    A node of the stored mesh has its value; any other point that of the cell that contains it, or,
    outside of the mesh, of its closest point.

    Parameters
    ----------
    run : Path
        The folder of the run.
    step : int
        The number of the state among those of fields.pvd; -1 is the last.
    kinematics : str or None
        The kinematics that the run must have; None in three dimensions.
    points : (n, 3) array
        Reference coordinates [m].

    Returns
    -------
    displacement : (n, 3) array
        The displacements [m].
    distance : (n,) array
        The points' distances from the mesh [m].

    Raises
    ------
    BadInput
        If there is no such run or state, it cannot be read, or a point is far from its mesh.
    """
    record = load_record(run / "run.json")
    if record.get("kinematics") != kinematics:
        accepted = f"a run with kinematics = {kinematics!r}, not {record.get('kinematics')!r}"
        raise bad_value("start.run", str(run), accepted.replace("None", "none"))
    states = States(run / "fields.pvd")
    if not -len(states) <= step < len(states):
        accepted = f"a number from {-len(states)} to {len(states) - 1}: {run} has"
        raise bad_value("start.step", step, f"{accepted} {len(states)} states")
    u, mesh = states.displacement(step % len(states)), states.mesh
    nodes = np.asarray(mesh.points, dtype=float)
    size = float(np.linalg.norm(np.ptp(nodes, axis=0)))
    distance, closest = cKDTree(nodes).query(points)
    found = u[closest]
    others = np.flatnonzero(distance > _SAME_POINT * size)
    distance = np.zeros(len(points))
    if len(others):
        found[others], distance[others] = _interpolate(mesh, u, points[others])
    if distance.max(initial=0.0) > _LARGEST_DISTANCE * size:
        far = int(distance.argmax())
        raise BadInput(
            f"start.run = '{run}': expected a run of the same body: {points[far].tolist()} is "
            f"{distance[far]:.3g} outside of its mesh"
        )
    return found, np.where(distance > _SAME_POINT * size, distance, 0.0)


def _interpolate(mesh: Any, u: Array, points: Array) -> tuple[Array, Array]:
    """Return the displacement of the closest points of a mesh, and their distances."""
    inside = np.asarray(mesh.find_containing_cell(points))
    centres = cKDTree(mesh.cell_centers().points)
    number = min(_CANDIDATES, mesh.n_cells)
    found, distance = np.empty_like(points), np.full(len(points), np.inf)
    for row, point in enumerate(points):
        candidates: Any = [inside[row]]
        if inside[row] < 0:
            candidates = np.atleast_1d(centres.query(point, number)[1])
        for cell in candidates:
            gap, value = _closest(mesh.GetCell(int(cell)), point, u)
            if gap < distance[row]:
                distance[row], found[row] = gap, value
    return found, distance


def _closest(cell: Any, point: Array, u: Array) -> tuple[float, Array]:
    """Return the distance of a cell from a point, and the displacement at its closest point.

    VTK extrapolates in cells of higher degree, so that their coordinates are restricted here. A
    curved cell's point is the closest in these coordinates only.
    """
    from vtkmodules.vtkCommonCore import mutable

    nodes, number = cell.GetNumberOfPoints(), mutable(0)
    local, weights, at = [0.0] * 3, [0.0] * nodes, [0.0] * 3
    if cell.EvaluatePosition(point, at, number, local, mutable(0.0), weights) < 0:
        return np.inf, np.zeros(3)
    nearest = np.clip(local, 0.0, 1.0)
    if cell.GetNumberOfEdges() in _EDGES_OF_SIMPLICES:
        nearest /= max(1.0, nearest.sum())
    cell.EvaluateLocation(number, nearest, at, weights)
    indices = [cell.GetPointId(i) for i in range(nodes)]
    return float(np.linalg.norm(point - at)), np.array(weights) @ u[indices]
