"""The duels in fem_snh, for the benchmark and for its references: SCENE DEGREE CELLS.

Degree 0 asks for an accuracy of one per cent instead of a mesh: ``--accuracy 0.01``.
"""

from __future__ import annotations

from math import pi
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.optimize import brentq

import fem_snh
from benchmarks import Row
from benchmarks.accuracy_cases import goals_of, hertz
from benchmarks.asked_cases import Grid
from benchmarks.duels import scenes
from benchmarks.exact_goals import POWER, limit
from benchmarks.graded_meshes import at, graded, write
from fem_snh.errors import BadInput
from fem_snh.scenes import MaterialChoice, Reaction, Scene, load

#: Its goal for each scene, and its elements of degree 1 and 2.
GOALS = {
    "twist": ("top.moment.z", "Q1P0", "Q2"),
    "bar": ("end.z", "Q1", "Q2"),
    "cook": ("corner.y", "Q1P0", "Q2Q1"),
    "hertz": ("z = 0.force.z", "P2", "P2"),
    "blocks": ("top.force.z", "Q1", "Q2"),
    "inverted": ("", "Q1", "Q2"),
}
#: The energy of the duels: eq. 13 of Smith et al. 2018.
ENERGY = "stable_neo_hookean"
#: Cells of the meshes of the references.
MESHES = {"twist": (6, 9, 13), "bar": (4, 6, 9), "hertz": (8, 12, 16)}
#: What ``--accuracy`` asks for, and its ``--max-time`` [s].
ACCURACY, SECONDS = 0.01, 60.0
_BAR = Grid(
    ((0, 0.2), (0, 0.2), tuple(np.linspace(0, 1, 6))), {"top": at(2, 1.0), "bottom": at(2, 0.0)}
)


def build(name: str, element: str, cells: int, energy: str, folder: Path) -> Scene:
    """Return a scene with its goal among the outputs; a mesh is written to the folder."""
    duel = scenes.SCENES[name]
    choice: dict[str, Any] = {"name": energy, "E": duel.E, "nu": _ratio(duel)}
    if energy == "stable_neo_hookean":
        choice["barrier"] = False
    material = MaterialChoice.model_validate(choice)
    options: dict[str, Any] = {"element": element, "cells": cells}
    if name in ("bar", "blocks"):
        return Scene.model_validate(
            {"name": name, "element": element, **_own(name, cells, choice, folder)}
        )
    if name == "twist":
        about = Reaction(group="top", about=(0.5, 0.5, 1.0))
        scene = load("twist", angle=pi, **options).model_copy(update={"reactions": [about]})
    elif name == "cook":
        scene = load("cook", kinematics="layer", **options)
    elif name == "hertz":
        scene = hertz(**options)
    else:
        scene = load("scramble", **options)
    return scene.model_copy(update={"material": [material]})


def _ratio(duel: scenes.Duel) -> float:
    """Return Poisson's ratio."""
    return duel.lam / (2 * (duel.lam + duel.mu))


def _own(name: str, cells: int, material: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the keys of the scenes that are not built in."""
    if name == "bar":
        return {
            "mesh": _BAR.write(folder / f"bar_{cells}.msh", cells, 1.0, False),
            "material": material | {"density": 1000.0},
            "hold": [{"group": "top"}],
            "gravity": {"vector": (0, 0, -9.81)},
            "probe": [{"name": "end", "point": (0.1, 0.1, 0.0)}],
        }
    groups = ("lower", "upper")
    return {
        "mesh": {"source": "two_blocks", "parameters": {"upper_cells": cells + 1}},
        "cells": cells,
        "material": [material | {"group": group} for group in groups],
        "hold": [
            {"group": group, "components": [axis]}
            for group, axis in (("bottom", "z"), ("left", "x"), ("front", "y"))
        ],
        "move": [{"group": "top", "translate": (0, 0, -scenes.PRESSED), "components": ["z"]}],
        "contact": [{"groups": ("lower_top", "upper_bottom"), "method": "augmented_lagrangian"}],
        "reactions": ["top"],
    }


def solve(duel: scenes.Duel, degree: int, cells: int) -> dict[str, Any]:
    """Return the number, unknowns and counts of a run, on a mesh or to an accuracy."""
    name = next(key for key, scene in scenes.SCENES.items() if scene is duel)
    goal, *elements = GOALS[name]
    with TemporaryDirectory() as folder:
        scene = build(name, elements[max(degree, 1) - 1], cells, ENERGY, Path(folder))
        if degree:
            result = fem_snh.run(scene, progress=False)
            return _of_run(name, goal, result)
        asked = {"goals": [goal], "within": ACCURACY, "max_time": SECONDS}
        record = fem_snh.run(scene, accuracy=asked, progress=False).record
    found = record["accuracy"]
    last = next(level for level in found["levels"][::-1] if level["goals"])
    return {
        "number": abs(last["goals"][goal]["corrected"]),
        "unknowns": last["dofs"],
        "newton": sum(step["newton"] for step in record["steps"]),
        "status": f"{len(found['levels'])} levels, "
        + ("reached" if found["reached"] else last["reason"]),
    }


def _of_run(name: str, goal: str, result: Any) -> dict[str, Any]:
    """Return the number, unknowns and counts of a run on a mesh."""
    problem, steps = result.problem, result.record["steps"]
    if name == "inverted":
        u = problem.u.x.array.reshape(-1, 3)
        number = float(np.linalg.norm(u, axis=1).max())
    else:
        number = abs(goals_of(steps[-1])[goal])
    return {
        "number": number,
        "unknowns": problem.dofs,
        "newton": sum(step["newton"] for step in steps),
        "status": result.status,
    }


def references(folder: Path, energy: str) -> dict[str, Row]:
    """Return the goals' values for an energy: exact, or extrapolated from three meshes."""
    found = {}
    for name, meshes in MESHES.items():
        values = []
        for cells in meshes:
            scene = build(name, GOALS[name][2], cells, energy, folder)
            if name == "twist":
                path = folder / f"twist_{cells}.msh"
                write(
                    path,
                    [graded((0, 1), cells, POWER)] * 3,
                    {"bottom": at(2, 0.0), "top": at(2, 1.0)},
                )
                scene = scene.model_copy(update={"mesh": path, "cells": None})
            result = fem_snh.run(scene, progress=False)
            if not result.converged:
                raise BadInput(f"{name}, {energy}, {cells} cells: {result.status}")
            values.append(abs(goals_of(result.steps[-1])[GOALS[name][0]]))
        found[name] = limit(list(meshes), values)
    duel = scenes.SCENES["blocks"]
    given = {"barrier": False} if energy == "stable_neo_hookean" else {}
    material = fem_snh.material(energy, E=duel.E, nu=_ratio(duel), **given)
    s = 1 - scenes.PRESSED / 2

    def side(t: float) -> float:
        return float(material.pk1(np.diag([t, t, s]))[0, 0])

    t = brentq(side, 0.9, 1.2)
    found["blocks"] = {"value": -float(material.pk1(np.diag([t, t, s]))[2, 2]), "uncertainty": 0.0}
    return found


if __name__ == "__main__":
    scenes.main(solve)
