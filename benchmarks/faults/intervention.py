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

    The call precedes the second Newton iteration; in a monitor PETSc locks the solution vector, so
    that it could not be changed.
    """
    solves = 0

    def update(snes: Any, its: int) -> None:
        nonlocal solves
        solves += its == 0
        if (solves, its) == (CONVERGED_STEPS + 1, 1):
            intervene(snes)

    set_from_options = ProjectedNewton.setFromOptions

    def set_update(context: ProjectedNewton, snes: Any) -> None:
        set_from_options(context, snes)
        snes.setUpdate(update)

    setattr(ProjectedNewton, "setFromOptions", set_update)  # every SNES is set up by it
    runpy.run_module("fem_snh", run_name="__main__")
