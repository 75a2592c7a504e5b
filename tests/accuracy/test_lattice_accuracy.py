"""The accuracy of a body in a lattice, which is another body on each level."""

from __future__ import annotations

from typing import Any

import pytest
from running import solve

from fem_snh.scenes import validate

pytestmark = pytest.mark.mpi

#: A rod with round ends under its weight, held at the cells at one end: at finer ones, which hold a
#: smaller part of the round end, it sinks without a limit.
ROD: dict[str, Any] = {
    "name": "rod",
    "mesh": {
        "lattice": {"capsule": {"from": [0, 0, 0], "to": [1, 0, 0], "radius": 0.2}},
        "cell": 0.2,
    },
    "element": "Q1",
    "material": {"name": "stable_neo_hookean", "E": 3e6, "nu": 0.3, "density": 1000.0},
    "gravity": {"vector": [0, 0, -9.81]},
    "hold": [{"group": "xmin"}],
    "probe": [{"name": "tip", "point": [1, 0, 0]}],
}


def test_one_level_is_not_enough(comm: Any) -> None:
    """The first level alone might be within 20 %; on the second the tip sinks by 65 % more."""
    accuracy = {"goals": ["tip.z"], "within": 0.2, "max_dofs": 2000}
    result = solve(validate(ROD | {"accuracy": accuracy}, "rod"), comm)
    record = result.record["accuracy"]
    first, second, *_ = (level["goals"]["tip.z"] for level in record["levels"])
    assert abs(first["error"]) < 0.2 * abs(first["value"])
    assert second["value"] < 1.5 * first["corrected"] < 0
    assert second["within"] > 0.2 and not record["reached"]


def test_estimates_are_those_of_the_lattice(comm: Any) -> None:
    result = solve(validate(ROD | {"error": True}, "rod"), comm)
    (note,) = [note for note in result.notes if note["kind"] == "mesh"]
    assert note["text"].endswith("shows with half the cell, mesh.cell = 0.1")
