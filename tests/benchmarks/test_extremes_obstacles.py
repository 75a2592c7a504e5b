"""The benchmark ``extremes``: the families with obstacles on ranks."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import pytest
from running import solve

from benchmarks.extremes import drop, press

pytestmark = pytest.mark.one_debian


@pytest.mark.mpi
@pytest.mark.parametrize(
    "name", ["press-flat-in-one-step-nu0.45-Q1", "drop-long-step-nu0.4-P1-newmark"]
)
def test_energies_and_contacts_are_the_same_on_any_number_of_ranks(comm: Any, name: str) -> None:
    (scene,) = (c.loaded for c in [*drop.cases(True, 1), *press.cases(True, 1)] if c.name == name)
    tight = scene.model_copy(update={"petsc": {**scene.petsc, "snes_scaled_tol": 1e-12}})
    one, other = (solve(tight, ranks).steps for ranks in (MPI.COMM_SELF, comm))
    assert [s["energy"] for s in one] == pytest.approx([s["energy"] for s in other], rel=1e-8)
    counts = [
        [[row["contacts"] for row in s["obstacles"].values()] for s in steps if s["converged"]]
        for steps in (one, other)
    ]
    assert counts[0] == counts[1] and max(map(max, counts[0])) > 0
