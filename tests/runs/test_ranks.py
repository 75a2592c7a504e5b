"""Runs are reproducible: the same bits on as many ranks, the same energies on any number."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import fem_snh

#: Rounding that the order of sums over ranks makes, after a load step whose path is stable.
ENERGY = 1e-9
SCENES: list[tuple[str, dict[str, Any]]] = [
    ("twist", {"cells": 4}),
    ("stretch", {"cells": 4, "element": "P2", "steps": 4, "stretch": 1.6}),
    ("stretch", {"cells": 4, "element": "Q2Q1", "nu": 0.5, "steps": 2, "stretch": 1.4}),
]


@pytest.mark.one_debian("serial")
@pytest.mark.mpi
@pytest.mark.parametrize(("scene", "values"), SCENES, ids=lambda v: str(v))
def test_runs_are_reproducible(comm: MPI.Intracomm, scene: str, values: dict[str, Any]) -> None:
    first, again = (fem_snh.run(scene, comm=comm, progress=False, **values) for _ in range(2))
    same = np.array_equal(first.u.x.array, again.u.x.array)
    assert comm.allreduce(same, MPI.LAND)
    for key in ("energy", "residual", "newton", "linear"):
        assert [s[key] for s in first.steps] == [s[key] for s in again.steps]
    alone = fem_snh.run(scene, comm=MPI.COMM_SELF, progress=False, **values)
    energies = ([step["energy"] for step in run.steps] for run in (first, alone))
    np.testing.assert_allclose(*energies, rtol=ENERGY)
