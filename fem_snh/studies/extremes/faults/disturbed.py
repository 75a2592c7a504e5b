"""fem-snh to whose Newton solve something happens, once: in the middle of step `DONE` + 1."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from typing import Any

from fem_snh.solver import ProjectedNewton

#: Steps that are done before something happens.
DONE = 3


def run(happen: Callable[[Any], None]) -> None:
    """Run the program; call ``happen`` with the SNES, after a step's first Newton iteration.

    After it has been looked at: in a monitor, PETSc locks the vector.
    """
    solves, looked_at = 0, ProjectedNewton._test

    def test(self: ProjectedNewton, snes: Any, its: int, *arguments: Any) -> bool:
        nonlocal solves
        done = looked_at(self, snes, its, *arguments)
        solves += its == 0
        if (solves, its) == (DONE + 1, 1):
            happen(snes)
        return done

    ProjectedNewton._test = test  # type: ignore[assignment,method-assign]
    runpy.run_module("fem_snh", run_name="__main__")
