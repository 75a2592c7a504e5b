"""The benchmark ``extremes``: the families with obstacles, and their criteria."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import pytest
from running import solve

from benchmarks.extremes import drop, press
from benchmarks.extremes.cases import ends_clearly

pytestmark = pytest.mark.one_debian

DONE: dict[str, Any] = {"converged": True, "status": "converged", "steps": 1}
#: A run that stopped half-way, and a fall with its energies.
REASON = "stopped at load 0.5: a step of 1/64 of the nominal one still fails (DIVERGED_MAX_IT)"
STOPPED: dict[str, Any] = {"converged": False, "status": REASON, "steps": 1}
HALF: dict[str, Any] = {"steps": [{"load": 0.5, "converged": True, "energy": 2.0}]}


def fall(energy: float) -> dict[str, Any]:
    """Return the record of a fall with an energy at its start."""
    return HALF | {"time": {"start": {"energy": energy}}}


def plate(force: float) -> dict[str, Any]:
    """Return the record of a plate that exerts a force in z."""
    return {"steps": [{"obstacles": {"plate": {"force": [0.0, 0.0, force]}}}]}


def gap(depth: float) -> dict[str, Any]:
    """Return the record of a plate that a point has passed by some depth."""
    return {"steps": [{"obstacles": {"plate": {"penetration": depth}}}]}


@pytest.mark.parametrize(
    ("check", "record", "row", "message"),
    [
        (ends_clearly, HALF, DONE, ""),
        (ends_clearly, HALF, STOPPED, ""),
        (ends_clearly, {"steps": [{"load": 0.25, "converged": True}]}, STOPPED, REASON),
        (ends_clearly, {"steps": []}, STOPPED, "no reason"),
        (ends_clearly, HALF, STOPPED | {"status": "exit code 1: killed"}, "exit code 1: killed"),
        (drop._no_growth, fall(2.0), DONE, ""),
        (drop._no_growth, fall(1.99), DONE, "its energy grows to 2 J"),
        (drop._no_growth, fall(2.0), STOPPED, ""),
        (press._lets_through, plate(-3.9999), DONE, ""),
        (press._lets_through, plate(-2.0), DONE, "the force is 2 N instead of 4 N"),
        (press._lets_through, plate(-3.9999), STOPPED, "stopped"),
        (press._flattens, gap(2.4e-4), DONE, ""),
        (press._flattens, gap(2.6e-4), DONE, "the penetration is 0.00026 m"),
        (press._flattens, gap(2.4e-4), STOPPED, "stopped"),
    ],
)
def test_a_verdict(check: Any, record: Any, row: Any, message: str) -> None:
    why = check(record, row)
    assert why.startswith(message) and bool(why) == bool(message)


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
