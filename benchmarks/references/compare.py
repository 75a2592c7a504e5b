"""A published number beside ours: what every reference is made with."""

from __future__ import annotations

from typing import Any

from benchmarks import Row
from fem_snh.linalg.direct_solver import DIRECT_SOLVER
from fem_snh.runs import Result, run
from fem_snh.scenes import Scene

#: Residuals far below the differences that are looked for.
TIGHT = {"snes_scaled_tol": 1e-12, **DIRECT_SOLVER}


def solve(scene: str | Scene, **overrides: Any) -> tuple[Result, Any]:
    """A run and its last step, None if it did not get there. Collective."""
    options = {
        "hessian": "adaptive",
        "globalization": "linesearch",
        "petsc": DIRECT_SOLVER,
    } | overrides
    result = run(scene, progress=False, **options)
    return result, result.steps[-1] if result.converged else None


def compare(
    what: str,
    source: str,
    published: float,
    ours: float | None,
    limit: float | None = None,
    note: str = "",
) -> Row:
    """A row: the difference and its ``limit`` in per cent.

    ours : None where a run did not converge, which is not ok.
    limit : None where a value is shown for what it tells (``note``), not to be met.
    """
    difference = None if ours is None else 100 * (ours / published - 1)
    within = difference is not None and (limit is None or abs(difference) <= limit)
    row: Row = {"what": what, "source": source, "published": published, "ours": ours}
    row |= {"difference": difference, "limit": limit, "ok": within}
    return row | ({"note": note} if note else {})
