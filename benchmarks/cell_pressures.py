"""Iterations of Q1P0 and P2P0 with cell pressures eliminated and as unknowns, by nu and mesh."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import Row, split_list
from fem_snh.errors import choose
from fem_snh.runs import run

#: Meshes of each element in each scene, and the scene's settings.
SCENES: dict[str, tuple[dict[str, list[int]], dict[str, Any]]] = {
    "stretch": (
        {"Q1P0": [8, 16, 24, 32], "P2P0": [6, 10, 14]},
        {"steps": 1, "stretch": 1.2},
    ),
    "cook": (
        {"Q1P0": [32, 64, 96], "P2P0": [16, 32]},
        {"kinematics": "layer", "steps": 4, "material": "neo_hookean_bower"},
    ),
    "block": ({"Q1P0": [6, 12], "P2P0": [4, 8]}, {}),
}
#: Limit on the Newton iterations of a load step.
NEWTON_LIMIT = 7
#: Limits on the linear iterations of a Newton iteration; Cook's membrane is a layer of cells.
LINEAR_LIMITS = {"stretch": 20, "cook": 45, "block": 25}
#: Cells above which the condensed problem is left out: it takes minutes.
CONDENSED_CELLS = 4000
#: Relative difference of the two energies.
ENERGY_LIMIT = 1e-9


def rows(
    elements: str = "Q1P0,P2P0",
    scenes: str = "stretch,cook,block",
    nus: str = "0.49,0.499,0.4999",
    cells: str = "",
) -> Iterator[Row]:
    """Yield one row per scene, element, nu and mesh.

    Parameters
    ----------
    cells : str
        Meshes of all scenes and elements; default: those of `SCENES`.

    Yields
    ------
    dict
        ``mixed`` and ``condensed``: Newton and linear iterations of all steps, and their seconds.
    """
    for scene in split_list(scenes):
        meshes, settings = SCENES[choose("scene", scene, SCENES)]
        for element in split_list(elements):
            for nu in split_list(nus):
                own = meshes[choose("element", element, meshes)]
                for count in map(int, split_list(cells) or own):
                    given = {"element": element, "nu": float(nu), "cells": count}
                    yield {"scene": scene} | given | _row(scene, settings | given)


def _row(scene: str, given: dict[str, Any]) -> Row:
    """Return the measurements of a scene."""
    mixed = run(scene, static_condensation=False, progress=False, **given)
    row: Row = {"dofs": mixed.record["dofs"], "mixed": _sums(mixed)}
    steps = mixed.steps
    good = all(s["mixed_reason"].startswith("CONVERGED") for s in steps) and mixed.converged
    good &= max(s["newton"] for s in steps) <= NEWTON_LIMIT
    good &= max(s["linear"] / s["newton"] for s in steps) <= LINEAR_LIMITS[scene]
    if mixed.record["cells"] <= CONDENSED_CELLS:
        condensed = run(scene, static_condensation=True, progress=False, **given)
        row["condensed"] = _sums(condensed)
        energies = [result.steps[-1]["energy"] for result in (mixed, condensed)]
        row["difference"] = abs(energies[0] / energies[1] - 1)
        good &= row["difference"] <= ENERGY_LIMIT
    return row | {"limits": [NEWTON_LIMIT, LINEAR_LIMITS[scene], ENERGY_LIMIT], "ok": good}


def _sums(result: Any) -> list[float]:
    """Return Newton and linear iterations and seconds of all steps."""
    keys = ("newton", "linear", "seconds")
    return [round(sum(step[key] for step in result.steps), 2) for key in keys]
