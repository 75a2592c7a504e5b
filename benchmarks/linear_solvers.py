"""Iterative and direct linear solver on thin and compact bodies, and which the program chooses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import Row, split_list
from fem_snh.errors import choose
from fem_snh.runs import run

#: Scene, meshes and settings of each body: a cube, a bar ten times as long as thick, and a layer;
#: and of each section, on a mesh of two dimensions.
BODIES: dict[str, tuple[str, list[int], dict[str, Any]]] = {
    "cube": ("twist", [4, 8], {"steps": 1, "angle": 0.5}),
    "bar": ("stretch", [4, 6], {"steps": 1, "stretch": 1.1, "aspect": 10.0}),
    "layer": ("cook", [8, 16, 32], {"kinematics": "layer", "steps": 1, "force": 25.0}),
    "membrane": ("cook", [16, 32, 64, 128], {"kinematics": "plane_strain"}),
    "tube": ("tube", [16, 32, 64], {"kinematics": "plane_strain"}),
    "bushing": ("bushing", [16, 32, 64], {"kinematics": "axisymmetric_torsion"}),
    "cylinder": (
        "stretch",
        [32, 64, 128],
        {"kinematics": "axisymmetric", "steps": 2, "stretch": 1.5},
    ),
    "seal": ("seal", [32, 64], {"kinematics": "axisymmetric", "steps": 3, "squeeze": 0.15}),
}
#: Largest time of the chosen solver over the other one's. Both cost the same near the rule's limit,
#: where the number of Newton iterations decides, which depends on rounding.
LIMIT = 2.5


def rows(
    bodies: str = "cube,bar,layer",
    elements: str = "Q1,Q2,Q1P0,P2P0,Q2Q1,P2P1",
    nus: str = "0.3,0.49,0.499,0.4999",
    cells: str = "",
) -> Iterator[Row]:
    """Yield one row per body, element, mesh and nu.

    Parameters
    ----------
    cells : str
        Meshes of all bodies; default: those of `BODIES`.

    Yields
    ------
    dict
        ``iterative``, ``direct``: Newton and linear iterations and processor seconds of the run;
        ``ratio``: seconds of direct over iterative; ``chosen`` and its ``reason``.
    """
    for body in split_list(bodies):
        scene, meshes, settings = BODIES[choose("body", body, BODIES)]
        for element in split_list(elements):
            for count in map(int, split_list(cells) or meshes):
                for nu in split_list(nus):
                    given = {"element": element, "cells": count, "nu": float(nu)}
                    yield {"body": body} | given | _row(scene, settings | given)


def _row(scene: str, given: dict[str, Any]) -> Row:
    """Return the measurements of a body."""
    row: Row = {}
    seconds = {}
    chosen = run(scene, progress=False, **given).record
    # Both solve what the program solves: the condensed problem, or the one with cell pressures.
    if "static_condensation" in chosen:
        given = given | {"static_condensation": chosen["static_condensation"]}
    good = True
    for name in ("iterative", "direct"):
        result = run(scene, progress=False, petsc={"snes_linear_solver": name}, **given)
        counts = [sum(step[key] for step in result.steps) for key in ("newton", "linear")]
        seconds[name] = result.record["processor_seconds"]
        row |= {"dofs": result.record["dofs"], name: [*counts, round(seconds[name], 3)]}
        good &= result.converged
    row["ratio"] = round(seconds["direct"] / seconds["iterative"], 2)
    default = chosen["defaults"]["linear_solver"]
    row["chosen"] = "direct" if "cholesky" in default["value"] else "iterative"
    row["reason"] = default["reason"]
    cost = row["ratio"] if row["chosen"] == "direct" else 1 / row["ratio"]
    return row | {"limit": LIMIT, "ok": good and cost <= LIMIT}
