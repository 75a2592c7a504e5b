"""The family "scramble": vertices at random in twice the volume (Smith et al. 2018, Figure 3)."""

from __future__ import annotations

from itertools import product
from typing import Any

import pandas as pd

from fem_snh.studies.extremes.cases import PASS, POLICIES, Case, at_rest, scene_case

LABEL, BY = "-([QP][12])-", ("cells", "nu", "hessian", "globalization")
PICTURES = {
    "scramble.png": (
        "Scrambled and released (Smith et al. 2018, Figure 3).",
        [("scramble-Q1-*-nu0.49*-0", load, "nu = 0.49") for load in (0.0, 1.0)],
    )
}
#: Poisson's ratio at which the required runs start (continuation in Poisson's ratio).
START_NU = -0.3
NUS = (0.0, 0.3, 0.45, 0.49, 0.499)
ELEMENTS = ("Q1", "P1")
#: Cells along the edge of the two cubes.
SMALL, LARGE = 10, 15
#: Limit on the median of the Newton iterations of the large cube, at this nu.
MEDIAN_NU, MEDIAN_LIMIT = 0.49, 150


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
    """Return ``seeds`` cases of the small cube, a tenth as many of the large one, and descents."""

    def case(cells: int, element: str, nu: float, seed: int, plain: str = "") -> Case:
        """Return a case with continuation, or a plain descent with the policy ``plain``."""
        how: dict[str, Any] = POLICIES[plain] if plain else {"nu_continuation": [START_NU]}
        name = f"scramble-{element}-{cells}-nu{nu:g}-{seed}"
        return scene_case(
            "scramble",
            f"{name}-plain-{plain}" if plain else name,
            f"plain descent, {plain}: back at rest" if plain else "back at rest",
            at_rest, material, not plain, cells=cells, element=element, nu=nu, seed=seed, **how,
        )  # fmt: skip

    if quick:
        few = [case(4, *values, 0) for values in product(ELEMENTS, (0.3, 0.499))]
        return [*few, case(4, "Q1", 0.45, 0, "adaptive")]
    policies = [p for p in POLICIES if p != "exact"]  # the first direction of exact is uphill
    return [
        *(case(SMALL, *values) for values in product(ELEMENTS, NUS, range(seeds))),
        *(case(LARGE, *values) for values in product(ELEMENTS, NUS, range(max(1, seeds // 10)))),
        *(
            case(SMALL, element, nu, seed, policy)
            for element, nu, policy, seed in product(
                ELEMENTS, NUS, policies, range(max(1, seeds // 50))
            )
        ),
    ]


def aggregate_criteria(rows: pd.DataFrame) -> dict[str, str]:
    """Check the median of the Newton iterations of the large cube."""
    large = rows[(rows["expected"] == PASS) & (rows["cells"] == LARGE) & (rows["nu"] == MEDIAN_NU)]
    medians = large.groupby("element")["newton"].median()
    return {
        f"scramble, {element}, {LARGE}^3, nu = {MEDIAN_NU:g}: median of Newton iterations at most "
        f"{MEDIAN_LIMIT}": "" if median <= MEDIAN_LIMIT else f"it is {median:g}"
        for element, median in medians.items()
    }
