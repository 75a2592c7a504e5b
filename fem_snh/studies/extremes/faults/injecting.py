"""``python -m`` this is fem-snh with an SNES monitor that makes one number of u NaN, once."""

from __future__ import annotations

import runpy
from typing import Any

from fem_snh import solver

#: In which solve, after which of its iterations.
SOLVE, ITERATION = 4, 1


class Injector:
    """The monitor of an SNES."""

    def __init__(self) -> None:
        self.solves = 0

    def __call__(self, snes: Any, its: int, norm: float) -> None:
        self.solves += its == 0
        if (self.solves, its) == (SOLVE, ITERATION):
            x = snes.getSolution()
            values = x.array  # on every rank: PETSc remembers norms until someone may have written
            if x.comm.rank == 0:
                values[len(values) // 2] = float("nan")


def main() -> None:
    """Run the program with every SNES that is made so monitored."""
    create = solver.create

    def created(*arguments: Any, **options: Any) -> Any:
        snes = create(*arguments, **options)
        snes.setMonitor(Injector())
        return snes

    solver.create = created
    runpy.run_module("fem_snh", run_name="__main__")


if __name__ == "__main__":
    main()
