"""Linear iterations per Newton iteration of Taylor-Hood elements, by nu, mesh and scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import Row, split_list
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.errors import choose
from fem_snh.runs import run

#: Meshes of each scene, and settings that keep it short.
SCENES: dict[str, tuple[list[int], dict[str, Any]]] = {
    "cook": ([8, 16, 32], {"kinematics": "layer", "steps": 1, "force": 25.0}),
    "block": ([4, 8], {}),
    "stretch": ([6, 10, 14], {"steps": 1, "stretch": 1.2}),
}
#: Limit on the linear iterations per Newton iteration, and on the ratio of those at the largest nu
#: to those at the smallest.
LIMIT, GROWTH_LIMIT = 12, 2.0


def rows(
    elements: str = "",
    scenes: str = "cook,block,stretch",
    nus: str = "0.3,0.45,0.49,0.4999,0.5",
    cells: str = "",
    tolerance: float = 0.0,
) -> Iterator[Row]:
    """Yield one row per scene, mesh and element.

    Parameters
    ----------
    cells : str
        Meshes of all scenes; default: those of `SCENES`.
    tolerance : float
        Relative tolerance of linear solves; 0: the forcing term of Newton's method.

    Yields
    ------
    dict
        ``linear``: iterations per Newton iteration, by nu; ``growth``: the last over the first.
    """
    names = split_list(elements) or [e.name for e in ELEMENTS.values() if e.volume == "pressure"]
    petsc = {"snes_forcing_max": 0.0, "ksp_rtol": tolerance} if tolerance else {}
    for scene in split_list(scenes):
        meshes, settings = SCENES[choose("scene", scene, SCENES)]
        for element in names:
            for count in map(int, split_list(cells) or meshes):
                row: Row = {"scene": scene, "element": element, "cells": count}
                row |= {"tolerance": tolerance, "newton": {}, "linear": {}}
                good = True
                for nu in split_list(nus):
                    options: dict[str, Any] = {
                        "element": element,
                        "cells": count,
                        "nu": float(nu),
                    } | settings
                    result = run(scene, **options, petsc=petsc, progress=False)
                    newton = sum(step["newton"] for step in result.steps)
                    linear = sum(step["linear"] for step in result.steps)
                    row["newton"][nu], row["linear"][nu] = newton, round(linear / newton, 1)
                    good &= result.converged
                few = list(row["linear"].values())
                row["growth"] = round(few[-1] / few[0], 2)
                good &= max(few) <= LIMIT and row["growth"] <= GROWTH_LIMIT
                yield row | {"limits": [LIMIT, GROWTH_LIMIT], "ok": good}
