"""Compare a computed value with a published one."""

from __future__ import annotations

from typing import Any

from benchmarks import Row
from fem_snh.linalg.direct_solver import DIRECT_SOLVER
from fem_snh.runs import Result, run
from fem_snh.scenes import Scene

#: A tolerance far below the differences that are compared.
TIGHT = {"snes_scaled_tol": 1e-12, **DIRECT_SOLVER}


def solve(scene: str | Scene, **overrides: Any) -> tuple[Result, Any]:
    """Return a run and its last step, None if it did not converge. Collective."""
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
    """Return the row of a reference, with the difference in per cent.

    Parameters
    ----------
    ours : float or None
        The measured value; None if the run did not converge, and the row is then not ok.
    limit : float, optional
        On the difference [%]; None: the value is only shown.
    note : str
        For the page, in place of "ok".
    """
    difference = None if ours is None else 100 * (ours / published - 1)
    within = difference is not None and (limit is None or abs(difference) <= limit)
    row: Row = {"what": what, "source": source, "published": published, "ours": ours}
    row |= {"difference": difference, "limit": limit, "ok": within}
    return row | ({"note": note} if note else {})
