"""Scramble: vertices anywhere in twice the volume (Smith et al. 2018, Figure 3)."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from fem_snh.studies.extremes.cases import Case, at_rest, run_of
from fem_snh.studies.extremes.figures import Picture, counts
from fem_snh.studies.pages import markdown

title = "Scramble"
about = """\
Every vertex of a unit cube begins anywhere in a cube of twice its volume, four corners are pinned,
and the body is let go (the paper's Figure 3): `fem-snh run scramble`. It is to be back at rest, no
point further from home than 1e-6 of the side."""

NUS = (0.0, 0.3, 0.45, 0.49, 0.499)
ELEMENTS = ("Q1", "P1")
SMALL, LARGE = 10, 15
#: The paper's cube, larger: most Newton iterations in the median.
MEDIAN = 150


def cases(quick: bool, seeds: int) -> list[Case]:
    """``seeds`` of the small cube, a tenth as many of the large one."""
    sizes = {4: min(seeds, 2)} if quick else {SMALL: seeds, LARGE: max(1, seeds // 10)}
    return [
        run_of(
            "scramble",
            f"scramble-{element}-{cells}-nu{nu:g}-{seed}",
            "back at rest",
            at_rest,
            cells=cells,
            element=element,
            nu=nu,
            seed=seed,
        )
        for cells, count in sizes.items()
        for element in ELEMENTS
        for nu in NUS
        for seed in range(count)
    ]


def tables(rows: pd.DataFrame) -> str:
    """A line for each element, mesh and nu."""
    lines = [
        [element, f"{cells:g}^3", f"{nu:g}", *counts(mine)]
        for (element, cells, nu), mine in rows.groupby(["element", "cells", "nu"], sort=False)
    ]
    return markdown(["element", "cells", "nu", *counts.head], lines)


def pictures(out: Path) -> list[Picture]:
    """The first cube at nu = 0.49, before and after."""
    from fem_snh.render import main

    folders = sorted(out.glob("scramble-Q1-*-nu0.49-0"))
    if not folders:
        return []
    caption = "Scrambled, and let go: the paper's Figure 3."
    return [
        Picture(
            "scramble.png",
            caption,
            lambda: main(folders[0], out / "scramble.png", [0.0, 1.0]),
        )
    ]
