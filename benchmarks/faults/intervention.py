"""Run fem-snh and call a function once inside a Newton solve, after some steps have converged."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from typing import Any

from fem_snh.solver import ProjectedNewton

#: Load steps that converge before the intervention.
CONVERGED_STEPS = 3


def run_with_intervention(intervene: Callable[[Any], None]) -> None:
    """Run ``python -m fem_snh`` and call ``intervene(snes)`` in step `CONVERGED_STEPS` + 1.

    The call follows the convergence test of the first Newton iteration; in a monitor PETSc locks
    the solution vector, so that it could not be changed.
    """
    solves, original_test = 0, ProjectedNewton._test_convergence

    def test(self: ProjectedNewton, snes: Any, its: int, *arguments: Any) -> bool:
        nonlocal solves
        converged = original_test(self, snes, its, *arguments)
        solves += its == 0
        if (solves, its) == (CONVERGED_STEPS + 1, 1):
            intervene(snes)
        return converged

    ProjectedNewton._test_convergence = test  # type: ignore[assignment,method-assign]
    runpy.run_module("fem_snh", run_name="__main__")
