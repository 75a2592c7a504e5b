"""Newton and linear iterations on the twist, beside the paper's (section 6, "Twist Test")."""

from __future__ import annotations

from collections.abc import Iterator

from fem_snh.runs import run
from fem_snh.studies.bench import Row, words

#: The paper's iterations for the two quarter turns, to a looser tolerance.
PAPER = {"newton": [12, 16], "linear": [3278, 4956]}
#: At 15^3 no more Newton iterations than these, and fewer linear ones in all than the paper's.
LIMITS = {"clamp": [20, 34], "adaptive": [18, 18]}


def rows(
    cells: int = 15, hessians: str = "clamp,adaptive", tolerance: float = 1e-7
) -> Iterator[Row]:
    """One row per Hessian policy; residual norms are in E L^2."""
    for hessian in words(hessians):
        options = {"snes_scaled_tol": tolerance}
        result = run("twist", cells=cells, hessian=hessian, petsc=options, progress=False)
        row: Row = {"hessian": hessian, "cells": cells, "ranks": result.record["ranks"]}
        for key in ("newton", "linear", "residual", "energy", "seconds"):
            row[key] = [step[key] for step in result.steps]
        row |= {"converged": result.converged, "paper": PAPER}
        if hessian in LIMITS and cells == 15 and tolerance == 1e-7:
            limit = LIMITS[hessian]
            few = len(row["newton"]) == 2 and all(
                n <= most for n, most in zip(row["newton"], limit, strict=True)
            )
            small = all(r <= 1e-7 for r in row["residual"])
            fewer = sum(row["linear"]) < sum(PAPER["linear"])
            row |= {"limit": limit, "ok": result.converged and few and small and fewer}
        yield row
