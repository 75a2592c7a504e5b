"""The estimated errors of goals against those to solutions on fine meshes: effectivity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from math import isnan, nan

import fem_snh
from benchmarks import Row, split_list
from benchmarks.accuracy_cases import goals_of
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Probe, Scene, Traction, load

#: Elements, those of degree 2 on half the cells along an edge.
_ELEMENTS = "P1,Q1,Q1P0,P2,P2P0,P2P1,Q2,Q2Q1"
#: Cells of the three meshes from whose solutions the exact value is extrapolated, each twice as
#: fine as the one before; and the element.
REFERENCES = {
    "cook": ((8, 16, 32), "Q2Q1"),
    "twist": ((3, 6, 12), "Q2Q1"),
    "block": ((2, 4, 8), "Q2Q1"),
    "shear": ((3, 6, 12), "Q2Q1"),
    "bar": ((2, 4, 8), "P2P0"),
    "plane": ((16, 32, 64), "Q2Q1"),
    "sheet": ((16, 32, 64), "Q2"),
    "tube": ((8, 16, 32), "Q2Q1"),
    "rod": ((16, 32, 64), "Q2Q1"),
    "bushing": ((8, 16, 32), "Q2Q1"),
}
_GOALS = {
    "cook": ("corner.y", "tip.x", "energy"),
    "twist": ("top.force.z", "edge.x", "energy"),
    "block": ("middle.z", "energy"),
    "shear": ("corner.x", "corner.z", "energy"),
    "bar": ("end.z", "energy"),
    "plane": ("corner.y", "tip.x", "energy"),
    "sheet": ("corner.y", "tip.x", "energy"),
    "tube": ("inner.x", "outer.x", "energy"),
    "rod": ("right.force.y", "inside.x", "energy"),
    "bushing": ("inner.moment.y", "inner.force.y", "energy"),
}
#: Scenes of two dimensions that are built in, with their parameters.
_SECTIONS: dict[str, tuple[str, Row]] = {
    "plane": ("cook", {"kinematics": "plane_strain"}),
    "sheet": ("cook", {"kinematics": "plane_stress"}),
    "tube": ("tube", {"kinematics": "axisymmetric"}),
    "rod": ("stretch", {"kinematics": "axisymmetric", "stretch": 2.0, "steps": 4}),
    "bushing": ("bushing", {}),
}
#: Treatments of the volume term that a scene does not have.
_WITHOUT = {"sheet": ("mean", "pressure")}
#: Goals are estimated well in this range of the effectivity, and acceptably in that.
_WELL, _ACCEPTABLE = (0.7, 1.4), (0.5, 2.0)
#: An error below this part of the value is not compared: the extrapolation has one of its own.
_LEAST = 1e-4


def rows(
    scenes: str = "cook,twist,block,shear,bar",
    elements: str = _ELEMENTS,
    nus: str = "0.3,0.45,0.49,0.4999",
    cells: str = "4,8",
) -> Iterator[Row]:
    """Yield one row per goal of a scene, an element, a ratio and a mesh; then a summary.

    Parameters
    ----------
    scenes : str
        cook; twist: a cube turned by 1 radian; block: pressed on a quarter of its top; shear: a
        cube on a clamped bottom, sheared by a dead load; bar: two materials, of which one is a
        hundred times as stiff, bent by a dead load. Of two dimensions: plane and sheet,
        Cook's membrane in plane strain and plane stress; tube, inflated; rod, stretched
        to twice its length; bushing, turned and pushed.
    elements, nus, cells : str
        Elements, Poisson's ratios, cells along an edge (degree 2: half).

    Yields
    ------
    dict
        ``value``, ``error``: of the run; ``exact``: extrapolated from three fine meshes;
        ``effectivity``: the estimate over the error; ``gain``: how many times smaller the error of
        the corrected value is; ``cost``: seconds of the estimate over those of the run, without
        compilation.
    """
    found: list[Row] = []
    for scene in split_list(scenes):
        for nu in map(float, split_list(nus)):
            for element in split_list(elements):
                if ELEMENTS[element].volume in _WITHOUT.get(scene, ()):
                    continue
                for number in map(int, split_list(cells)):
                    count = number // ELEMENTS[element].degree
                    about = {"scene": scene, "nu": nu, "element": element, "cells": count}
                    case = scene_of(scene, nu, element, count, estimate=True)
                    for row in compared(case, about, exact(scene, nu), _LEAST):
                        found.append(row)
                        yield row
    yield summary(found)


def compared(
    scene: Scene, about: Row, exact_goals: Mapping[str, float], least: float
) -> Iterator[Row]:
    """Yield the rows of a scene's goals whose exact values are known.

    Errors below a part ``least`` of the goal's scale are left out. The ``bound`` is that of the
    corrected value, over the true error of the value.
    """
    result = fem_snh.run(scene, progress=False)
    reason = result.record.get("estimate", {}).get("reason") or ""
    if not result.converged or reason:
        yield about | {"reason": reason or result.status}
        return
    seconds, estimate = result.record["seconds"], result.record["estimate"]
    run = seconds["assemble"] + seconds["solve"]
    for name, goal in (result.estimate.goals if result.estimate else {}).items():
        true = exact_goals.get(name, nan)
        error = true - goal.value
        if isnan(true) or abs(error) < least * goal.scale or goal.estimate is None:
            continue
        row = about | {"goal": name, "value": goal.value, "error": goal.estimate, "exact": true}
        row["true_error"] = abs(error / goal.scale)
        if goal.bound is not None:
            row["bound"] = goal.bound / abs(error)
        effectivity, left = goal.estimate / error, abs(goal.value + goal.estimate - true)
        yield row | {
            "effectivity": effectivity,
            "gain": abs(error) / left if left else None,
            "newton": estimate["newton"],
            "linear": estimate["linear"],
            "cost": (estimate["seconds"] - estimate["jit"]) / run,
            "ok": _ACCEPTABLE[0] <= effectivity <= _ACCEPTABLE[1],
        }


def summary(rows: list[Row]) -> Row:
    """Return how many estimates there are, and the parts of them that are good."""
    stated = [row for row in rows if "effectivity" in row]
    count = max(1, len(stated))
    well = sum(_WELL[0] <= row["effectivity"] <= _WELL[1] for row in stated)
    better = sum((row["gain"] or 3) >= 3 for row in stated)
    bounds = [row["bound"] for row in rows if "bound" in row]
    cost = sorted(row["cost"] for row in stated)
    return {
        "summary": len(stated),
        "without": len(rows) - len(stated),
        "well": well / count,
        "acceptable": sum(row["ok"] for row in stated) / count,
        "three_times_better": better / count,
        "bounds": len(bounds),
        "bounds_hold": sum(bound >= 1 for bound in bounds),
        "median_cost": cost[len(cost) // 2] if cost else None,
    }


@cache
def exact(scene: str, nu: float) -> Mapping[str, float]:
    """Return the goals, extrapolated from three meshes by their observed order."""
    meshes, element = REFERENCES[scene]
    found = []
    for cells in meshes:
        result = fem_snh.run(scene_of(scene, nu, element, cells), progress=False)
        found.append(goals_of(result.steps[-1]) if result.converged else {})
    return {name: _extrapolated([goals.get(name, nan) for goals in found]) for name in found[0]}


def _extrapolated(values: list[float]) -> float:
    """Return the limit of values whose errors are a geometric sequence (Aitken), else NaN."""
    coarse, middle, fine = values
    ratio = (fine - middle) / (middle - coarse) if middle != coarse else nan
    return fine + (fine - middle) * ratio / (1 - ratio) if 0 < ratio < 0.7 else nan


def scene_of(name: str, nu: float, element: str, cells: int, estimate: bool = False) -> Scene:
    """Return a scene, with goals whose errors are estimated if asked for."""
    goals = {"goals": list(_GOALS[name])} if estimate else None
    common: Row = {"element": element, "cells": cells, "accuracy": goals}
    if name in _SECTIONS:
        scene, parameters = _SECTIONS[name]
        return load(scene, nu=nu, **parameters, **common)
    if name == "twist":
        return load(name, nu=nu, angle=1.0, **common)
    if name == "cook":
        return load(name, nu=nu, kinematics="layer", **common)
    if name == "block":
        return load(name, nu=nu, **common)
    one = MaterialChoice(name="stable_neo_hookean", E=1.0, nu=nu)
    if name == "shear":
        return Scene(
            name="shear",
            mesh=Geometry(source="cube"),
            material=one,
            hold=[Hold(group="bottom")],
            traction=[Traction(group="top", vector=(0.03, 0, 0))],
            probe=[Probe(name="corner", point=(1, 1, 1))],
            **common,
        )
    return Scene(
        name="bar",
        mesh=Geometry(source="bar"),
        material=[
            one.model_copy(update={"group": "first", "E": 100.0}),
            one.model_copy(update={"group": "second"}),
        ],
        hold=[Hold(group="left")],
        traction=[Traction(group="right", vector=(0, 0, 0.005))],
        probe=[Probe(name="end", point=(2, 1, 1))],
        steps=2,
        **common,
    )
