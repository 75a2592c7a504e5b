"""The errors of goals after each step, from those at the end and a run on half the cells."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from running import solve

import fem_snh
from fem_snh.scenes import Scene, load


def stretched(cells: int, error: Any = True) -> Scene:
    """A body of revolution that is stretched; inside, two causes of an error cancel halfway."""
    given = {"element": "Q1P0", "kinematics": "axisymmetric", "steps": 6}
    return load("stretch", cells=cells, **given).model_copy(update={"error": error})


@pytest.fixture(scope="module")
def exact() -> dict[str, np.ndarray]:
    """The corrected curves on three times as many cells each way, with a ninth of the error."""
    return {name: corrected(curve) for name, curve in solve(stretched(24)).estimate.curves.items()}


def corrected(curve: Any) -> np.ndarray:
    return np.array([curve.values[at] + curve.errors[at] for at in sorted(curve.values)])


@pytest.mark.parametrize(("error", "gain"), [(True, 10), ("coarser", 1.5)])
def test_bounds_hold_after_each_step(exact: Any, error: Any, gain: float) -> None:
    curves = solve(stretched(8, error)).estimate.curves
    assert {"axis.y", "inside.x", "right.force.y", "energy"} <= set(curves)
    for name, curve in curves.items():
        known = exact[name]
        bounds = np.array([curve.bounds[at] for at in sorted(curve.bounds)])
        assert (np.abs(corrected(curve) - known) <= bounds + 1e-9 * np.abs(known).max()).all()
    known, curve = exact["right.force.y"], curves["right.force.y"]
    values = np.array([curve.values[at] for at in sorted(curve.values)])
    assert np.abs(corrected(curve) - known).max() < np.abs(values - known).max() / gain


def test_steps_have_the_errors_of_their_loads(tmp_path: Any) -> None:
    result = fem_snh.run(stretched(6), out=tmp_path / "run", progress=False)
    table = pd.read_csv(tmp_path / "run" / "steps.csv")
    curve = result.estimate.curves["right.force.y"]
    for kind, by_load in zip(("", ".error", ".bound"), curve, strict=True):
        column = table[f"right.force.y{kind}"].to_numpy()
        assert column == pytest.approx([by_load[round(at, 9)] for at in table["load"]])
    goal = result.goals["right.force.y"]
    assert table["right.force.y.error"].iloc[-1] == pytest.approx(goal["error"])
    assert table["right.force.y.bound"].iloc[-1] == pytest.approx(goal["bound"])


@pytest.mark.mpi
def test_ranks_have_the_same_curves(comm: Any) -> None:
    curve = solve(stretched(6), comm).estimate.curves["right.force.y"]
    assert len({repr(curve)} | set(comm.allgather(repr(curve)))) == 1
