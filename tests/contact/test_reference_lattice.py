"""Self-contact of a lattice's skin by the map to the reference configuration."""

from __future__ import annotations

from typing import Any

import pytest

import fem_snh
from fem_snh import scenes

mpi = pytest.mark.mpi


def fingers(angle: float) -> Any:
    """Two fingers on a palm in a lattice, whose bones turn towards each other.

    The gap is half of a cell wide, so that both pass through some of the cells.
    """
    capsules = [((-0.07, 0, 0), (-0.07, 0, 0.2), 0.06), ((0.07, 0, 0), (0.07, 0, 0.2), 0.06)]
    palm = ((-0.07, 0, -0.02), (0.07, 0, -0.02), 0.07)
    shapes = [
        {"capsule": dict(zip(("from", "to", "radius"), c, strict=True))} for c in (*capsules, palm)
    ]
    bones = [
        {
            "name": name,
            "shape": {"capsule": {"from": [x, 0, 0.1], "to": [x, 0, 0.2], "radius": 0.025}},
            "rotate": {"axis": [0, 1, 0], "through": [x, 0, 0], "angle": turn},
        }
        for name, x, turn in (("left", -0.07, angle), ("right", 0.07, -angle))
    ]
    palm_bone = {"name": "palm", "shape": {"sphere": {"center": [0, 0, -0.02], "radius": 0.05}}}
    return scenes.validate(
        {
            "name": "fingers",
            "mesh": {"lattice": {"union": shapes}, "cell": 0.04},
            "element": "Q1",
            "steps": 2,
            "material": {"name": "stable_neo_hookean", "E": 2e4, "nu": 0.45},
            "bone": [palm_bone, *bones],
            "self_contact": {"method": "reference"},
        },
        "fingers",
    )


@mpi
def test_fingers_of_a_lattice() -> None:
    """The skin touches, not the cells, which overlap in the mesh: no pair pushes at rest."""
    result = fem_snh.run(fingers(0.1), progress=False)
    rows = [row["self_contact"] for row in result.steps]
    assert result.converged and rows[0]["pairs"] == 0 and rows[0]["force"] == 0
    assert rows[1]["pairs"] > 0 and 0 < rows[1]["penetration"] < 0.05 * 0.04
    without = fingers(0.1).model_copy(update={"self_contact": None})
    assert fem_snh.run(without, progress=False).steps[1]["energy"] < result.steps[1]["energy"]
