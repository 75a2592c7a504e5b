"""Scenes in time, with contact, by every Hessian and globalisation."""

from __future__ import annotations

import numpy as np
import pytest
from running import solve
from time_scenes import SWING, in_time

from fem_snh.choices import GLOBALIZATIONS, HESSIANS
from fem_snh.scenes import Scene

#: A plane that the swinging cube hits, with friction.
FLOOR = {"name": "floor", "shape": {"plane": {"point": [0, 0, -0.05]}}, "friction": 0.3}


def landed(hessian: str, globalization: str) -> np.ndarray:
    """Return the displacement of a cube that has swung onto the floor, and how it was solved."""
    scene = in_time({"duration": 0.2, "steps": 8}, **SWING)
    changes = {"hessian": hessian, "globalization": globalization, "obstacle": [FLOOR]}
    result = solve(Scene.model_validate({**dict(scene), **changes}))
    row = result.steps[-1]["obstacles"]["floor"]
    assert result.converged and row["contacts"] > 0 and row["force"][2] > 0
    assert result.record["terms"] == ["elastic", "gravity", "obstacle", "inertia"]
    return result.problem.x.array.copy()


@pytest.mark.one_debian
def test_every_hessian_and_globalization_gives_the_same_motion() -> None:
    expected = landed(HESSIANS[0], GLOBALIZATIONS[0])
    assert abs(expected).max() > 0.04
    for hessian in HESSIANS:
        for globalization in GLOBALIZATIONS:
            found = landed(hessian, globalization)
            assert found == pytest.approx(expected, abs=1e-7), (hessian, globalization)
