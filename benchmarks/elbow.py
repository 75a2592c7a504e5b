"""Smith et al. 2018, Figures 2 and 10: a flexed elbow by Poisson's ratio, and StVK in its biceps.

Limits: the flesh's volume rises with Poisson's ratio; at 0.488 it is at least 0.995, with at most 8
Newton iterations in a step of 10 degrees and at most 15 in one of 90. In the biceps, StVK with the
volume term of Kikuuwe et al. takes at least 1.8 times the iterations of stable Neo-Hookean and
loses at least 2 % more of the volume.
"""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row, split_list
from fem_snh.runs import Result, run
from fem_snh.scenes.builtin.biceps import biceps
from fem_snh.scenes.builtin.elbow import elbow

#: Limits at the ratio of the paper's characters.
RATIO, VOLUME, NEWTON, NEWTON_OF_ONE_STEP = 0.488, 0.995, 8, 15
#: Limits of StVK: Newton iterations over those of stable Neo-Hookean (paper 2.3), volume lost.
ITERATIONS, LOST = 1.8, 0.02
#: Flexion in a step [degrees].
_ANGLE = 10


def rows(
    cells: int = 40,
    nus: str = "0,0.3,0.45,0.488,0.499",
    angles: str = "90,120",
    cells_of_biceps: int = 30,
    materials: str = "stable_neo_hookean,stvk_kikuuwe",
) -> Iterator[Row]:
    """Flex the elbow, and the strong arm of the scene biceps.

    Parameters
    ----------
    cells : int
        Cells along the arm of the scene elbow.
    nus : str
        Poisson's ratios.
    angles : str
        Flexions [degrees], in steps of 10 degrees; 90 at nu = 0.488 also in one step.
    cells_of_biceps : int
        Cells along the arm of the scene biceps; 0: leave it out.
    materials : str
        Materials of the biceps; the first one is what the others are compared with.
    """
    for angle in map(int, split_list(angles)):
        volume = 0.0
        for nu in sorted(map(float, split_list(nus))):
            row = measure(run(elbow(cells, angle), nu=nu, steps=angle // _ANGLE, progress=False))
            ok = row["converged"] and row["flesh"] > volume
            if nu == RATIO:
                ok &= row["flesh"] >= VOLUME and row["most"] <= NEWTON
            volume = row["flesh"]
            yield {"flexion": angle, "nu": nu} | row | {"ok": ok}
    if RATIO in map(float, split_list(nus)):
        row = measure(run(elbow(cells, 90), nu=RATIO, steps=1, progress=False))
        ok = row["converged"] and row["most"] <= NEWTON_OF_ONE_STEP
        yield {"flexion": 90, "nu": RATIO} | row | {"ok": ok}
    if cells_of_biceps:
        yield from strong_arm(cells_of_biceps, split_list(materials))


def strong_arm(cells: int, materials: list[str]) -> Iterator[Row]:
    """Yield a row for each material in the scene biceps."""
    first: Row = {}
    for material in materials:
        row = measure(run(biceps(cells), material=material, progress=False))
        if first:
            row["iterations"] = round(row["newton"] / first["newton"], 2)
            row["lost"] = round(first["flesh"] - row["flesh"], 5)
            row["ok"] = row["iterations"] >= ITERATIONS and row["lost"] >= LOST
        first = first or row
        yield {"scene": "biceps", "material": material} | row


def measure(result: Result) -> Row:
    """Return the volume of the flesh at the end, and the iterations of a run."""
    steps = result.steps
    return {
        "cells": result.record["cells"],
        "dofs": result.record["dofs"],
        "ranks": result.record["ranks"],
        "steps": len(steps),
        "converged": result.converged,
        "flesh": round(steps[-1]["volumes"]["flesh"], 6),
        "min_J": round(steps[-1]["min_J"], 3),
        "newton": sum(step["newton"] for step in steps),
        "most": max(step["newton"] for step in steps),
        "linear": sum(step["linear"] for step in steps),
        "seconds": round(sum(step["seconds"] for step in steps), 1),
    }
