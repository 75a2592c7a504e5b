"""Newton and linear iterations on the twist, beside those of Smith et al. 2018, section 6."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import Row, policy, split_list
from fem_snh.runs import run

#: Iterations of the paper for the two quarter turns, to a larger tolerance.
PAPER = {"newton": [12, 16], "linear": [3278, 4956]}
#: Limits on the Newton iterations at 15^3 cells; the linear ones are limited by those of `PAPER`.
LIMITS = {"clamp": [20, 34], "adaptive": [18, 18]}


def rows(
    cells: int = 15,
    hessians: str = "clamp,adaptive",
    tolerance: float = 1e-7,
    nu: float = 0.49,
    steps: int = 2,
    most: int = 200,
) -> Iterator[Row]:
    """Yield one row per Hessian policy; residuals are in E L^2.

    Parameters
    ----------
    steps : int
        Equal angles to half a turn.
    most : int
        Limit on the Newton iterations of a step.

    Yields
    ------
    dict
        ``expected``: "converges", or why a failure is expected.
    """
    for hessian in split_list(hessians):
        options = {"snes_scaled_tol": tolerance, "snes_max_it": most}
        settings: dict[str, Any] = {"cells": cells, "nu": nu, "steps": steps}
        settings |= policy(hessian)
        result = run("twist", **settings, petsc=options, progress=False)
        row: Row = policy(hessian) | {"cells": cells, "ranks": result.record["ranks"]}
        row |= {"nu": nu, "filtered": [step["clamped"] for step in result.steps]}
        for key in ("newton", "linear", "residual", "energy", "seconds"):
            row[key] = [step[key] for step in result.steps]
        row |= {"converged": result.converged, "min_J": [step["min_J"] for step in result.steps]}
        row["paper"] = PAPER
        indefinite = "may fail: the unfiltered Hessian is indefinite (Smith et al. 2018, section 6)"
        row["expected"] = indefinite if hessian == "exact" else "converges"
        if hessian in LIMITS and (cells, tolerance, nu, steps) == (15, 1e-7, 0.49, 2):
            limit = LIMITS[hessian]
            few = len(row["newton"]) == 2 and all(
                n <= most for n, most in zip(row["newton"], limit, strict=True)
            )
            small = all(r <= 1e-7 for r in row["residual"])
            fewer = sum(row["linear"]) < sum(PAPER["linear"])
            row |= {"limit": limit, "ok": result.converged and few and small and fewer}
        yield row
