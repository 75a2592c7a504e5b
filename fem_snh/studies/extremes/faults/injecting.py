"""``python -m`` this is fem-snh with a Newton solve that one number of u turns NaN in, once."""

from __future__ import annotations

import runpy
from typing import Any

from fem_snh.solver import ProjectedNewton

#: In which solve, after which of its iterations.
SOLVE, ITERATION = 4, 1


class Injector:
    """Comes after a Newton iteration has been looked at: in a monitor, PETSc locks the vector."""

    def __init__(self) -> None:
        self.solves = 0

    def __call__(self, snes: Any, its: int) -> None:
        self.solves += its == 0
        if (self.solves, its) == (SOLVE, ITERATION):
            x = snes.getSolution()
            values = x.array  # on every rank: PETSc remembers norms until someone may have written
            if x.comm.rank == 0:
                values[len(values) // 2] = float("nan")


def main() -> None:
    """Run the program with every Newton solve so disturbed."""
    inject, looked_at = Injector(), ProjectedNewton._test

    def test(self: ProjectedNewton, snes: Any, its: int, *arguments: Any) -> bool:
        done = looked_at(self, snes, its, *arguments)
        inject(snes, its)
        return done

    ProjectedNewton._test = test  # type: ignore[assignment,method-assign]
    runpy.run_module("fem_snh", run_name="__main__")


if __name__ == "__main__":
    main()
