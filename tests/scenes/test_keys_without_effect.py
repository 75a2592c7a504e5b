"""Keys that would have no effect in their scene are refused in one line."""

from __future__ import annotations

from typing import Any

import pytest

from fem_snh import scenes
from fem_snh.errors import BadInput

RAMP = {"name": "ramp", "points": [[0, 0], [1, 1]]}
TOP = {"group": "top"}
HINGE = {"kind": "hinge", "axis": [0, 1, 0], "through": [0, 0, 1]}
AROUND = {"name": "edge", "point": [1, 1, 1], "radius": 0.5}
SLIDER = {**HINGE, "kind": "slider"}
BALL = {"sphere": {"center": [0, 0, 2], "radius": 0.1}}


def rigid(**keys: Any) -> dict[str, Any]:
    """Return the top of `twist` as a rigid part, in place of its motion."""
    return {"move": [], "rigid": [{**TOP, **keys}]}


def held(key: str, way: str, **keys: Any) -> tuple[dict[str, Any], str]:
    """Return a load or a spring of a part that cannot move, or turn, with the message."""
    return rigid(**keys), f"rigid.0.{key}: expected no value, as nothing lets the part {way} so"


SOLID: list[tuple[dict[str, Any], str]] = [
    ({"table": [RAMP]}, "table.0.name = 'ramp': expected a name that the key 'table' of a load"),
    ({"table": [{**RAMP, "points": [[0, 0], [10, 1]]}], "move.0.table": "ramp"},
     r"table.0.points = \[\[0.0, 0.0\], \[10.0, 1.0\]\]: expected loads from 0 to 1"),
    ({"move.0.translate": [0, 0.1, 0.2], "move.0.components": ["x", "y"]},
     r"move.0.translate = \[0.0, 0.1, 0.2\]: expected zero along z, which 'components'"),
    ({"table": [RAMP], **rigid(load_table="ramp")},
     "rigid.0: missing key 'force', 'torque', 'joint.torque' or 'joint.force': expected with"),
    ({"table": [RAMP], **rigid(load_table="rmp", force=[0, 0, 1])},
     "rigid.0.load_table = 'rmp': expected one of ramp .did you mean 'ramp'"),
    (rigid(load_table="r", force=[0, 0, 1]), r"rigid.0.load_table = 'r': expected .*has none"),
    (rigid(follower=True), "rigid.0: missing key 'force' or 'torque': expected with 'follower'"),
    (rigid(free=["z"], translate=[0, 0, 1]), "rigid.0.free = 'z': expected motions that"),
    (rigid(free=["rotation"], rotate={"axis": [0, 0, 1], "angle": 1}),
     "rigid.0.free = 'rotation': expected motions that"),
    held("spring.stiffness = 1.0", "move", spring={"stiffness": 1.0}, joint=HINGE),
    held("spring.rotation = 1.0", "turn", spring={"rotation": 1.0}, joint=SLIDER),
    held("spring.rotation = 1.0", "turn", spring={"rotation": 1.0}, translate=[0, 0, 1]),
    held(r"force = \[0.0, 0.0, 2.0\]", "move", force=[0, 0, 2], translate=[0, 0, 1]),
    held(r"torque = \[0.0, 0.0, 2.0\]", "turn", torque=[0, 0, 2], translate=[0, 0, 1]),
    held(r"force = \[0.0, 0.0, 2.0\]", "move", force=[0, 0, 2], joint=HINGE),
    held("torque = .*", "turn", torque=[1, 0, 2], joint=HINGE),
    held("force = .*", "move", force=[1, 0, 2], joint=SLIDER),
    held("torque = .*", "turn", torque=[1, 0, 2], joint=SLIDER),
    ({"nu": 0.3, "nu_continuation": [0.2, 0.3]},
     r"nu_continuation = \[0.2, 0.3\]: expected ratios below 0.3, that of the material"),
    ({"fields_at": "nodes"}, "fields_at = 'nodes': expected no value, as 'fields' names none"),
    ({"fields_at": "nodes", "fields": ["reaction_force"]},
     "fields_at = 'nodes': expected no value, as 'fields' names none"),
    ({"static_condensation": True},
     "static_condensation = 'true': expected no value, as only P2P0 and Q1P0 have"),
    ({"start": {"seed": 3}, "predictor": "none"},
     "start: missing key 'scatter' or 'noise': expected with 'seed'"),
    ({"modes": {"density": 7.0}, "material.density": 1.0},
     "modes.density = 7.0: expected no value, as each material has its density"),
    ({"mesh": {"lattice": "body.stl", "cell": 0.1, "skin": 3}, "cells": None},
     "mesh.skin = 3: expected no value, as the surface is that of body.stl"),
    ({"obstacle": [{"shape": BALL, "table": "ramp"}], "table": [RAMP]},
     "obstacle.0: missing key 'translate' or 'rotate': expected with 'table'"),
]  # fmt: skip


@pytest.mark.parametrize(("overrides", "message"), SOLID, ids=[str(m[0]) for m in SOLID])
def test_in_three_dimensions(overrides: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=f"^twist: .*{message}"):
        scenes.load("twist", **overrides)


def test_in_a_plane() -> None:
    start = {"map": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}
    with pytest.raises(BadInput, match=r"^cook: start.map = .*: expected a map that leaves z"):
        scenes.load("cook", start=start, predictor="none")


def test_loads_that_a_part_can_follow() -> None:
    """A follower turns to a free direction, and another part takes what a joint carries."""
    turned = {"rotate": {"axis": [0, 0, 1], "angle": 1}, "free": ["x"]}
    scenes.load("twist", **rigid(**turned, force=[1, 1, 0], follower=True))
    parts = [
        {**TOP, "joint": {**HINGE, "to": "bottom"}, "force": [1, 1, 1], "torque": [1, 0, 0]},
        {"group": "bottom"},
    ]
    assert len(scenes.load("twist", hold=[], move=[], rigid=parts).rigid) == 2


@pytest.mark.mpi
def test_the_radius_of_a_probe_without_a_goal(comm: Any) -> None:
    import fem_snh

    given: dict[str, Any] = {"cells": 1, "probe": [AROUND], "comm": comm, "progress": False}
    message = "probe.0.radius = 0.5: expected no value, as accuracy.goals does not name 'edge.str"
    for goals in ({}, {"error": True}, {"accuracy": {"goals": ["edge.x"]}}):
        with pytest.raises(BadInput, match=message):
            fem_snh.run("twist", **given, **goals)
