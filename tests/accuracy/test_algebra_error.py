"""What Newton's method leaves is a part of the error, and small beside a request."""

from __future__ import annotations

import numpy as np
import pytest
from running import solve

GOALS = ["tip.y", "corner.x", "energy"]
#: Newton's tolerances: one that leaves percents of the displacement, and the default.
LOOSE, DEFAULT = 1e-2, 1e-7


def cook(comm, tolerance, **keys):
    return solve(
        "cook", comm=comm, kinematics="plane_strain", element="Q1P0", cells=8, nu=0.49, steps=2,
        petsc={"snes_scaled_tol": tolerance}, **keys,
    )  # fmt: skip


@pytest.mark.one_debian
@pytest.mark.mpi
def test_a_loose_solve_is_corrected_as_a_tight_one(comm):
    """The estimate does not change the run."""
    goals = {"goals": GOALS}
    loose, tight = (cook(comm, tol, error=True, accuracy=goals) for tol in (LOOSE, DEFAULT))
    alone = cook(comm, LOOSE)
    assert alone.steps[-1]["energy"] == pytest.approx(loose.steps[-1]["energy"], rel=1e-13)
    x = alone.problem.x.array  # on several ranks sums of two runs differ by rounding
    np.testing.assert_allclose(x, loose.problem.x.array, rtol=0, atol=1e-11 * np.abs(x).max())
    for name in GOALS:
        found, exact = loose.goals[name], tight.goals[name]
        assert abs(exact["value"] - found["value"]) > 1e-3 * abs(exact["value"])
        assert found["corrected"] == pytest.approx(exact["corrected"], rel=1e-3)


def test_levels_have_a_tolerance_that_suffices(comm):
    fine = solve("cook", comm=comm, kinematics="plane_strain", element="Q2Q1", cells=16, nu=0.49)
    exact = fine.steps[-1]["probes"]["tip"][1]
    accuracy = {"goals": ["tip.y"], "within": 0.01, "keep_element": True}
    found = cook(comm, LOOSE, accuracy=accuracy).record["accuracy"]
    assert found["reached"]
    assert found["levels"][-1]["goals"]["tip.y"]["corrected"] == pytest.approx(exact, rel=0.01)
