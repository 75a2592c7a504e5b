"""``python -m`` this is fem-snh with a Newton solve that one number of u turns NaN in, once."""

from __future__ import annotations

from typing import Any

from fem_snh.studies.extremes.faults import disturbed


def inject(snes: Any) -> None:
    """One of the first rank's unknowns is NaN from now on."""
    x = snes.getSolution()
    values = x.array  # on every rank: PETSc remembers norms until someone may have written
    if x.comm.rank == 0:
        values[len(values) // 2] = float("nan")


if __name__ == "__main__":
    disturbed.run(inject)
