"""The table [[obstacle]] of a scene: shapes, motions, files and mistakes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scene_file import motions_of

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.geometry.shapes import Box, Capsule, Cylinder, Plane, Sphere

pytestmark = pytest.mark.one_debian

BALL: dict[str, Any] = {"sphere": {"center": [0, 0, -1], "radius": 0.5}}
ENDS: dict[str, Any] = {"from": [0, 0, 0], "to": [0, 0, 1], "radius": 0.5}
ON_BALL: dict[str, Any] = {"shape": BALL}


def obstacles(*tables: dict[str, Any], **keys: Any) -> list[Any]:
    """Return the obstacles of a scene."""
    scene = scenes.load("twist", obstacle=list(tables), **keys)
    assert scenes.load(scene) == scene  # also through the names 'from' and 'to'
    return [obstacle.moving(scene.amplitudes) for obstacle in scene.obstacle]


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ({"plane": {}}, Plane((0, 0, 0), (0, 0, 1))),
        (BALL, Sphere((0, 0, -1), 0.5)),
        ({"capsule": ENDS}, Capsule((0, 0, 0), (0, 0, 1), 0.5)),
        ({"cylinder": {**ENDS, "infinite": True}}, Cylinder((0, 0, 0), (0, 0, 1), 0.5, True)),
        ({"box": {"center": [0, 0, 0], "size": [1, 2, 3]}}, Box((0, 0, 0), (1, 2, 3))),
    ],
)
def test_shapes(shape: dict[str, Any], expected: Any) -> None:
    assert obstacles({"shape": shape})[0].shape == expected


def test_a_motion_is_that_of_move() -> None:
    keys: dict[str, Any] = {
        "translate": [1, 0, 0.5],
        "rotate": {"axis": [0, 1, 1], "angle": 0.8, "through": [1, 2, 3], "table": "late"},
        "table": "ramp",
    }
    tables = [
        {"name": "ramp", "points": [[0, 0], [0.5, 2], [1, -1]]},
        {"name": "late", "points": [[0.5, 0], [1, 1]]},
    ]
    scene = scenes.load("twist", table=tables, move=[{"group": "top", **keys}])
    (obstacle,) = obstacles({**ON_BALL, **keys}, table=tables)
    X = np.random.default_rng(0).normal(size=(6, 3))
    for load in (0.0, 0.25, 0.7, 1.0):
        expected = X + motions_of(scene)[0].displacement(X, load)
        assert np.allclose(obstacle.pose(load).apply(X), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "obstacle.0: expected one of the keys shape, surface; found none"),
        ({"shape": {}}, "obstacle.0.shape: expected one of the keys plane, .*box, .*; found none"),
        ({"shape": {"capsule": {**ENDS, "to": [0, 0, 0]}}},
         "obstacle.0.shape.capsule.to = .*: expected a point other than 'from'"),
        ({"shape": {"plane": {"normal": [0, 0, 0]}}}, "shape.plane.normal = .*: expected a vector"),
        ({**ON_BALL, "surface": "a.stl"},
         "expected one of the keys shape, surface; found shape, surface"),
        ({**ON_BALL, "tolerance": 1e-3}, "tolerance = 0.001: expected no value, as the method"),
        ({**ON_BALL, "table": "ramp"}, "obstacle.0: missing key 'translate' or 'rotate'"),
        ({**ON_BALL, "motion": "a.csv", "translate": [0, 0, 1]},
         "obstacle.0: 'motion' and 'translate' exclude each other"),
        ({**ON_BALL, "translate": [0, 0, 1], "table": "ramp"},
         "obstacle.0.table = 'ramp': expected the name of a .*; the scene has none"),
    ],
)  # fmt: skip
def test_mistakes(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=f"^twist: .*{message}") as error:
        scenes.load("twist", obstacle=[keys])
    assert "\n" not in str(error.value)
