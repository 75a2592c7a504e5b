"""The family "scramble": vertices at random in twice the volume (Smith et al. 2018, Figure 3)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.studies.extremes.cases import PASS, POLICIES, Case, at_rest, scene_case
from fem_snh.studies.extremes.pictures import COUNTS, Picture, body_picture, counts
from fem_snh.studies.markdown import markdown_table

title = "Scramble"
#: Poisson's ratio at which the required runs start (continuation in Poisson's ratio).
START_NU = -0.3
about = f"""\
Every vertex of a unit cube starts at a random position in a cube of twice its volume, four corners
are fixed, and the body is released (Smith et al. 2018, Figure 3): `fem-snh run scramble`. The
criterion is that the body returns to rest: no point is further than 1e-6 of the side from its rest
position.

An energy that is finite for every F does not guarantee this. From a scramble a descent may end in
another minimum: most cells have J > 0 and some stress, and the lowest eigenfrequency is positive.
For nu >= 0.45 this is common on tetrahedra and happens on hexahedra; at nu = 0.499 the descent
itself converges slowly. The runs that are expected to pass therefore find the equilibrium at
nu = {START_NU:g} first (`nu_continuation = [{START_NU:g}]`), where the volume term is too weak to
keep cells inverted. The rest state is an equilibrium for every nu, so the run at the real nu has
little left to do. Newton iterations of both runs are counted. The descents without continuation may
fail."""

NUS = (0.0, 0.3, 0.45, 0.49, 0.499)
ELEMENTS = ("Q1", "P1")
#: Cells along the edge of the two cubes.
SMALL, LARGE = 10, 15
#: Limit on the median of the Newton iterations of the large cube, at this nu.
MEDIAN_NU, MEDIAN_LIMIT = 0.49, 150


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
    """Return ``seeds`` cases of the small cube, a tenth as many of the large one, and descents."""
    own: dict[str, Any] = {"material": material} if material else {}
    if quick:
        some = [_case(element, 4, nu, 0, **own) for element in ELEMENTS for nu in (0.3, 0.499)]
        return [*some, _case("Q1", 4, 0.45, 0, "adaptive", **own)]
    sizes = {SMALL: seeds, LARGE: max(1, seeds // 10)}
    continued = [
        _case(element, cells, nu, seed, **own)
        for cells, count in sizes.items()
        for element in ELEMENTS
        for nu in NUS
        for seed in range(count)
    ]
    plain = [
        _case(element, SMALL, nu, seed, policy, **own)
        for element in ELEMENTS
        for nu in NUS
        for policy in POLICIES
        for seed in range(max(1, seeds // 50))
        if policy != "exact"  # its first direction is uphill
    ]
    return continued + plain


def _case(element: str, cells: int, nu: float, seed: int, plain: str = "", **own: Any) -> Case:
    """Return a case with continuation, or a plain descent with the policy ``plain``."""
    how: dict[str, Any] = POLICIES[plain] if plain else {"nu_continuation": [START_NU]}
    return scene_case(
        "scramble",
        f"scramble-{element}-{cells}-nu{nu:g}-{seed}" + (f"-plain-{plain}" if plain else ""),
        f"plain descent, {plain}: back at rest" if plain else "back at rest",
        at_rest,
        required=not plain and not own,
        cells=cells,
        element=element,
        nu=nu,
        seed=seed,
        **how,
        **own,
    )


def aggregate_criteria(rows: pd.DataFrame) -> dict[str, str]:
    """Check the median of the Newton iterations of the large cube."""
    large = rows[(rows["expected"] == PASS) & (rows["cells"] == LARGE) & (rows["nu"] == MEDIAN_NU)]
    found = {}
    for element, group in large.groupby("element"):
        median = group["newton"].median()
        criterion = (
            f"scramble, {element}, {LARGE}^3, nu = {MEDIAN_NU:g}: "
            f"median of Newton iterations at most {MEDIAN_LIMIT}"
        )
        found[criterion] = "" if median <= MEDIAN_LIMIT else f"it is {median:g}"
    return found


def tables(rows: pd.DataFrame) -> str:
    """Return a line for each element, mesh, nu and Hessian."""
    lines = [
        [element, f"{cells:g}^3", f"{nu:g}", hessian, globalization, *counts(group)]
        for (element, cells, nu, hessian, globalization), group in rows.groupby(
            ["element", "cells", "nu", "hessian", "globalization"], sort=False
        )
    ]
    return markdown_table(["element", "cells", "nu", "Hessian", "globalization", *COUNTS], lines)


def pictures(out: Path) -> list[Picture]:
    """Return the first cube at nu = 0.49, scrambled and released."""
    found = sorted(out.glob("scramble-Q1-*-nu0.49*-0"))
    name = found[0].name if found else ""
    if not (found or (out / "scramble.png").exists()):
        return []
    panels = [(name, 0.0, "scrambled"), (name, 1.0, "released")]
    caption = "Scrambled and released (Smith et al. 2018, Figure 3)."
    return [body_picture(out, "scramble.png", panels, caption)]
