"""Reactions of groups: each has the force of its own conditions, also at nodes that it shares."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from running import solve

pytestmark = pytest.mark.mpi

#: A cube that is clamped at its left side and pulled at its right one, on a smooth floor.
CLAMPED: dict[str, Any] = {
    "scene": "twist",
    "cells": 3,
    "steps": 1,
    "move": [],
    "traction": [{"group": "right", "vector": [0.05, 0.02, 0.0]}],
    "reactions": ["left", "bottom", "top"],
    "nu": 0.3,
}
FLOORS = [
    {"hold": [{"group": "left"}, {"group": "bottom", "components": ["z"]}]},
    {"hold": [{"group": "left"}], "symmetry": [{"group": "bottom"}]},
]


@pytest.mark.parametrize("floor", FLOORS, ids=["roller", "symmetry"])
def test_a_smooth_floor_has_no_friction(comm: Any, floor: dict[str, Any]) -> None:
    """At its edge with the clamped side it had 8 % of that side's force."""
    keys = CLAMPED | floor | {"accuracy": {"goals": ["bottom.force", "left.force.x"]}}
    result = solve(keys.pop("scene"), comm=comm, **keys)
    reactions = {name: np.array(force) for name, force in result.steps[-1]["reactions"].items()}
    assert reactions["left"] == pytest.approx([-0.05, -0.02, reactions["left"][2]], abs=1e-7)
    assert reactions["bottom"][:2] == pytest.approx([0, 0], abs=1e-15)
    assert abs(reactions["bottom"][2]) > 1e-3
    goals = result.goals
    for axis, force in zip("xyz", reactions["bottom"], strict=True):
        assert goals[f"bottom.force.{axis}"]["value"] == pytest.approx(force, abs=1e-12)
    # The top has no condition: its force is that of the nodes that it shares with the left side.
    (note,) = [note["text"] for note in result.notes if "reactions" in note["text"]]
    assert note.startswith("reactions of 'top': no condition is of this group, and others constra")
    assert "constrain 4 of its 16 nodes" in note and np.linalg.norm(reactions["top"]) > 1e-3


def test_a_group_that_others_cover_has_their_forces(comm: Any) -> None:
    """That of all cells has the sum of all, which balances the load."""
    keys = CLAMPED | FLOORS[0] | {"reactions": ["body"]}
    result = solve(keys.pop("scene"), comm=comm, **keys)
    assert result.steps[-1]["reactions"]["body"] == pytest.approx([-0.05, -0.02, 0], abs=1e-7)
    assert not [note for note in result.notes if "reactions" in note["text"]]
