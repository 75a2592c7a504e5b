"""The values of goals to 0.1 %: sections and graded meshes, extrapolated by their observed order.

``--write benchmarks/exact_goals.json`` stores them with this command. Cook's membrane, the stretch
and Hertz's contact are problems of two dimensions; of the other bodies the mesh is graded.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from math import inf, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.optimize import brentq

import fem_snh
from benchmarks import Row, asked_cases
from benchmarks.accuracy_cases import CASES, bracket, goals_of, twist
from benchmarks.graded_meshes import at, graded, write
from fem_snh.contact.obstacle import Obstacle
from fem_snh.errors import BadInput, choose
from fem_snh.files import replace_file
from fem_snh.mesh.gmsh_input import generate, source_path
from fem_snh.mesh.gmsh_model import SizeField, session
from fem_snh.mesh.mesh import distribute, write_xdmf
from fem_snh.scenes import Geometry, Hold, Reaction, Scene, load
from fem_snh.scenes.builtin.hertz import RADIUS

#: A goal from a folder for the mesh, and the number of cells.
Solve = Callable[[Path, int], float]
#: Tolerance of the solver, a hundredth of the scenes' own.
TIGHT = {"snes_scaled_tol": 1e-9}
#: Power of the grading: cells decrease with the square of their number from a corner.
POWER = 2.0
#: The same at a re-entrant corner, where the displacement grows with the distance to 0.54.
STRONG = 3.0
#: The uncertainty of an extrapolated value over the last change, at least.
_LEAST = 0.2
#: The uncertainty of one that four meshes agree on, over the extrapolation.
_OF_STEP = 0.1
#: The length of the arm, and the centres of the round ends of its bones at the elbow [m].
LENGTH_OF_ARM, ENDS_OF_BONES = 0.52, np.array([(-0.045, 0, -0.022), (0.045, 0, -0.022)])
#: Displacement of the plane of Hertz's contact [mm], that of the scene.
DEPTH = 0.2
#: Orders of errors with which a limit is extrapolated.
_ORDERS = (0.7, 8.0)


def rows(only: str = "", write: str = "", finest: str = "") -> Iterator[Row]:
    """Yield the values of the goals of each case on three or more meshes, and their limit.

    Parameters
    ----------
    only : str
        Cases, separated by semicolons as their names have commas.
    write : str
        A file of JSON in which the values of these cases are replaced.
    finest : str
        The finest mesh, in cells of the section or the body; default: that of each case.

    Yields
    ------
    dict
        ``value``: extrapolated by the observed order from the last three meshes; ``uncertainty``:
        the extrapolation, or a fifth of the last change if that is more, relative; of four meshes
        the difference to the value of the first three, and at least a tenth of the extrapolation.
    """
    done, goals = {}, {name: case.goal for name, case in (CASES | asked_cases.CASES).items()}
    for case in ([w.strip() for w in only.split(";") if w.strip()]) or list(MESHES):
        meshes, functions = MESHES[choose("only", case, MESHES)]
        start, sizes = perf_counter(), [n for n in meshes if n <= float(finest or inf)]
        with TemporaryDirectory() as folder:
            limits = [limit(sizes, [f(Path(folder), n) for n in sizes]) for f in functions]
        row: Row = {"case": case, "goal": goals[case]} | limits[0]
        for other in limits[1:]:
            change = abs(other["value"] / row["value"] - 1)
            row["uncertainty"] = max(row["uncertainty"], change)
        row |= {"seconds": round(perf_counter() - start, 1)}
        done[case] = {key: value for key, value in row.items() if key not in ("case", "seconds")}
        if write:
            _store(Path(write), done)
        yield row


def _store(path: Path, done: dict[str, Row]) -> None:
    """Replace the values of these cases in a file."""
    stored = json.loads(path.read_text(encoding="utf-8"))["values"] if path.exists() else {}
    command = f"python -m benchmarks exact_goals --write {path}"
    text = json.dumps({"command": command, "values": stored | done}, indent=2)
    replace_file(path, text + "\n")


def limit(cells: list[int], values: list[float]) -> Row:
    """Return the limit of values whose errors are a power of the size of cells."""
    if len(values) < 3:
        raise BadInput(f"finest = {cells[-1]}: expected a number that leaves three meshes")
    n = np.array(cells[-3:], dtype=float)
    before, last = values[-2] - values[-3], values[-1] - values[-2]

    def ratio(order: float) -> float:
        powers = n**-order
        return float((powers[1] - powers[2]) / (powers[0] - powers[1]))

    order, step = None, 0.0
    found = last / before if before else 0.0
    if ratio(_ORDERS[1]) < found < ratio(_ORDERS[0]):
        order = float(brentq(lambda p: ratio(p) - found, *_ORDERS))
        step = last / ((n[2] / n[1]) ** order - 1)
    value = values[-1] + step
    error = max(abs(step), _LEAST * abs(last)) if step else max(abs(last), _LEAST * abs(before))
    if step and len(values) > 3:
        before = limit(cells[:-1], values[:-1])["value"]
        error = min(error, max(abs(value - before), _OF_STEP * abs(step)))
    return {
        "value": value,
        "uncertainty": abs(error / value),
        "order": order and round(order, 2),
        "cells": cells,
        "values": values,
    }


def cook(nu: float, power: float = POWER) -> Solve:
    """Return the function that solves Cook's membrane in plane strain on graded meshes."""
    corners = np.array([(0, 0), (48, 44), (48, 60), (0, 44)])

    def solve(folder: Path, cells: int) -> float:
        def mapped(x: Any) -> Any:
            s, t = x.T[..., None]
            weights = ((1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t)
            return sum(w * corner for w, corner in zip(weights, corners, strict=True))

        axis, path = graded((0, 1), cells, power), folder / f"cook_{cells}.msh"
        sides = {"left": at(0, 0.0), "right": at(0, 1.0)}
        write(path, [axis, axis], sides, mapping=mapped)
        scene = load("cook", nu=nu, kinematics="plane_strain")
        return goal(scene, path, "Q2" if nu < 0.4 else "Q2Q1", "corner.y")

    return solve


def stretch(folder: Path, cells: int) -> float:
    """Return the force on the end of the stretched cylinder, from its section."""
    path = folder / f"stretch_{cells}.msh"
    axes = [graded((-0.5, 0.5), 2 * cells, POWER)[cells:], graded((0, 1), 2 * cells, POWER)]
    write(path, axes, {"left": at(1, 0.0), "right": at(1, 1.0)})
    return goal(load("stretch", kinematics="axisymmetric"), path, "Q2Q1", "right.force.y")


def quarter_turn(folder: Path, cells: int) -> float:
    """Return the moment that turns the cube."""
    axis, path = graded((0, 1), cells, POWER), folder / f"twist_{cells}.msh"
    write(path, [axis] * 3, {"bottom": at(2, 0.0), "top": at(2, 1.0)})
    return goal(twist(), path, "Q2Q1", "top.moment.z")


def bent(folder: Path, cells: int) -> float:
    """Return the displacement of the tip of the bracket, of which half of the depth is solved."""
    path = folder / f"bracket_{cells}.msh"
    along = [graded((0, 1, 3), cells, STRONG), graded((0, 2, 3), cells, STRONG)]
    # The half of the depth that is graded towards the free face z = 1.
    across = graded((0, 1), cells, STRONG)[cells // 2 :]
    sides = {"bottom": at(1, 0.0), "end": at(0, 3.0), "middle": at(2, 0.5)}
    write(path, [*along, across], sides, inside=lambda x: (x[:, 0] < 1) | (x[:, 1] > 2))
    scene = bracket()
    hold = [*scene.hold, Hold(group="middle", components=("z",))]
    return goal(scene.model_copy(update={"hold": hold}), path, "Q2", "tip.y")


def flexed(element: str) -> Solve:
    """Return the function that solves the flexed elbow on cells that are small at the joint."""

    def solve(folder: Path, cells: int) -> float:
        arm, path = source_path("arm"), folder / f"elbow_{element}_{cells}.xdmf"
        known = load("elbow").mesh
        assert isinstance(known, Geometry)
        parameters = {**known.parameters, "order": 2.0, "cells": float(cells)}
        coarse = generate(arm, "tetrahedron", {**parameters, "cells": 60.0, "order": 1.0})
        x = coarse.x[coarse.cells]
        distances = [np.linalg.norm(x - end, axis=2) for end in ENDS_OF_BONES]
        beyond = np.maximum(0, np.minimum(*distances) - 0.015)
        field = SizeField(x, LENGTH_OF_ARM / cells * np.minimum(1.2, 0.15 + beyond / 0.06))
        data = generate(arm, "tetrahedron", parameters, field)
        write_xdmf(distribute(MPI.COMM_SELF, "arm", lambda: data), path)
        return goal(load("elbow"), path, element, "energy")

    return solve


def hertz(folder: Path, cells: int) -> float:
    """Return the force on the middle of the ball's octant, a quarter of that on its section."""
    scene = load("hertz", cells=cells, depth=DEPTH)
    assert isinstance(scene.mesh, Geometry)
    path = folder / f"hertz_{cells}.msh"
    _quarter_disc(path, scene.mesh.parameters["zone"], cells)
    obstacle = Obstacle.model_validate(
        {
            "name": "plane",
            "group": "surface",
            "shape": {"plane": {"point": [0, -RADIUS, 0], "normal": [0, 1, 0]}},
            "translate": [0, DEPTH, 0],
            "method": "augmented_lagrangian",
            "tolerance": 1e-8,
        }
    )
    update = {
        "obstacle": [obstacle],
        "kinematics": "axisymmetric",
        "hold": [Hold(group="axis", components=("x",)), Hold(group="middle", components=("y",))],
        "reactions": [Reaction(group="middle")],
    }
    return goal(scene.model_copy(update=update), path, "P2", "middle.force.y") / 4


def _quarter_disc(path: Path, zone: float, cells: int) -> None:
    """Write a quarter of a disc of curved triangles, fine within the zone about its pole."""
    with session() as gmsh:
        geo, model = gmsh.model.geo, gmsh.model
        for tag, (x, y) in enumerate([(0, 0), (RADIUS, 0), (0, -RADIUS)], start=1):
            geo.addPoint(x, y, 0, tag=tag)
        curves = [geo.addLine(1, 3), geo.addCircleArc(3, 1, 2), geo.addLine(2, 1)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(curves)])
        geo.synchronize()
        field = model.mesh.field.add("MathEval")
        distance = f"Sqrt(x^2 + (y + {RADIUS})^2)"
        edge = f"Abs({distance} - {sqrt(RADIUS * DEPTH)!r})"
        size = f"{zone / cells} * Min(1, 0.05 + {edge} / {0.3 * zone})"
        size += f" + 0.35 * Max(0, {distance} - {zone}) * {6 / cells}"
        model.mesh.field.setString(field, "F", size)
        model.mesh.field.setAsBackgroundMesh(field)
        for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
        for dim, entity, name in (
            (2, surface, "body"),
            (1, curves[0], "axis"),
            (1, curves[1], "surface"),
            (1, curves[2], "middle"),
        ):
            model.setPhysicalName(dim, model.addPhysicalGroup(dim, [entity]), name)
        model.mesh.generate(2)
        model.mesh.setOrder(2)
        gmsh.write(str(path))


def goal(scene: Scene, path: Path, element: str, name: str) -> float:
    """Return a goal of a scene on the mesh of a file."""
    return _goals(scene.model_copy(update={"mesh": path, "cells": None, "element": element}))[name]


def _goals(scene: Scene) -> dict[str, float]:
    petsc = {**scene.petsc, **TIGHT}
    result = fem_snh.run(scene.model_copy(update={"petsc": petsc}), progress=False)
    if not result.converged:
        raise BadInput(f"{scene.name} on {scene.mesh}: {result.status}")
    return goals_of(result.steps[-1])


#: For each case the cells of its meshes, and its functions: the limit of the first one's values
#: has at least the difference to that of the others as its uncertainty.
MESHES: dict[str, tuple[tuple[int, ...], list[Solve]]] = {
    "cook, nu 0.3": ((16, 32, 64), [cook(0.3, STRONG), cook(0.3)]),
    "cook, nu 0.4999": ((16, 32, 64), [cook(0.4999, STRONG), cook(0.4999)]),
    "stretch": ((8, 16, 32), [stretch]),
    "quarter turn": ((3, 6, 12), [quarter_turn]),
    "bracket": ((4, 8, 16), [bent]),
    "elbow": ((20, 28, 40), [flexed("P2P1"), flexed("P2P0")]),
    "hertz": ((8, 16, 32), [hertz]),
}
MESHES |= {
    name: (case.meshes, [case.reference])
    for name, case in asked_cases.CASES.items()
    if not isinstance(case, asked_cases.Known) and case.exact is None
}
