"""Scramble: vertices anywhere in twice the volume (Smith et al. 2018, Figure 3)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.choices import HESSIANS
from fem_snh.studies.extremes.cases import Case, at_rest, run_of
from fem_snh.studies.extremes.pictures import Picture, bodies, counts
from fem_snh.studies.markdown import markdown

title = "Scramble"
#: The ratio with which every run begins.
SOFT = -0.3
about = f"""\
Every vertex of a unit cube begins anywhere in a cube of twice its volume, four corners are pinned,
and the body is let go (the paper's Figure 3): `fem-snh run scramble`. It is to be back at rest, no
point further from home than 1e-6 of the side.

An energy that is finite for every F does not promise that. From a scramble a descent may end in a
minimum that is not home: most cells have J > 0 and some stress, and the lowest eigenfrequency is
positive. For nu >= 0.45 that is usual on tetrahedra, and it happens on hexahedra; at 0.499 the
descent itself crawls. So what must hold is asked of runs that first find the equilibrium of the
same material at nu = {SOFT:g} (`nu_continuation = [{SOFT:g}]`), whose volume term is too
weak to keep cells where they are. Home is an equilibrium for every nu, so little is
then left to do at the real one.
The Newton iterations of both are counted. The plain descents are there to be compared."""

NUS = (0.0, 0.3, 0.45, 0.49, 0.499)
ELEMENTS = ("Q1", "P1")
SMALL, LARGE = 10, 15
#: The larger cube at this nu: at most so many Newton iterations in the median.
AT, MEDIAN = 0.49, 150


def cases(quick: bool, seeds: int) -> list[Case]:
    """``seeds`` of the small cube, a tenth as many of the large one; a few plain descents."""
    if quick:
        some = [_case(element, 4, nu, 0) for element in ELEMENTS for nu in (0.3, 0.499)]
        return [*some, _case("Q1", 4, 0.45, 0, "adaptive")]
    sizes = {SMALL: seeds, LARGE: max(1, seeds // 10)}
    must = [
        _case(element, cells, nu, seed)
        for cells, count in sizes.items()
        for element in ELEMENTS
        for nu in NUS
        for seed in range(count)
    ]
    compared = [
        _case(element, SMALL, nu, seed, hessian)
        for element in ELEMENTS
        for nu in NUS
        for hessian in HESSIANS
        for seed in range(max(1, seeds // 50))
        if hessian != "exact"  # its first direction is uphill
    ]
    return must + compared


def _case(element: str, cells: int, nu: float, seed: int, plain: str = "") -> Case:
    """One that must hold, or a plain descent with this Hessian."""
    how: dict[str, Any] = {"hessian": plain} if plain else {"nu_continuation": [SOFT]}
    return run_of(
        "scramble",
        f"scramble-{element}-{cells}-nu{nu:g}-{seed}" + (f"-plain-{plain}" if plain else ""),
        f"plain descent, {plain}" if plain else "back at rest",
        at_rest,
        must=not plain,
        cells=cells,
        element=element,
        nu=nu,
        seed=seed,
        **how,
    )


def demands(rows: pd.DataFrame) -> dict[str, str]:
    """What the paper's cube may cost."""
    paper = rows[rows["must"] & (rows["cells"] == LARGE) & (rows["nu"] == AT)]
    found = {}
    for element, mine in paper.groupby("element"):
        median = mine["newton"].median()
        asked = f"scramble, {element}, {LARGE}^3, nu = {AT:g}: median of Newton at most {MEDIAN}"
        found[asked] = "" if median <= MEDIAN else f"it is {median:g}"
    return found


def tables(rows: pd.DataFrame) -> str:
    """A line for each element, mesh, nu and Hessian."""
    lines = [
        [element, f"{cells:g}^3", f"{nu:g}", hessian, *counts(mine)]
        for (element, cells, nu, hessian), mine in rows.groupby(
            ["element", "cells", "nu", "hessian"], sort=False
        )
    ]
    return markdown(["element", "cells", "nu", "Hessian", *counts.head], lines)


def pictures(out: Path) -> list[Picture]:
    """The first cube at nu = 0.49, before and after."""
    found = sorted(out.glob("scramble-Q1-*-nu0.49*-0"))
    panels = [(found[0].name, 0.0, "scrambled"), (found[0].name, 1.0, "let go")] if found else []
    caption = "Scrambled, and let go: the paper's Figure 3."
    return [bodies(out, "scramble.png", panels, caption)] if panels else []
