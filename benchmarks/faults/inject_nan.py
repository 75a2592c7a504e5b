"""fem-snh with one NaN written into the solution vector, once, in the middle of a step.

``python -m benchmarks.faults.inject_nan`` takes the arguments of ``fem-snh``.
"""

from __future__ import annotations

from typing import Any

from benchmarks.faults.intervention import run_with_intervention


def inject_nan(snes: Any) -> None:
    """Set one unknown of rank 0 to NaN."""
    x = snes.getSolution()
    values = x.array  # on every rank: access for writing invalidates the norms that PETSc caches
    if x.comm.rank == 0:
        values[len(values) // 2] = float("nan")


if __name__ == "__main__":
    run_with_intervention(inject_nan)
