"""Amplitude tables of a scene: their values, the loads and motions that name them, mistakes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene_file import TOML, motions_of

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.scenes import Amplitude

pytestmark = pytest.mark.one_debian

RAMP: dict[str, Any] = {"name": "ramp", "points": [[0, 0], [0.5, 2], [1, -1]]}


@pytest.mark.parametrize(
    ("load", "value"), [(0, 0), (0.25, 1), (0.5, 2), (0.75, 0.5), (1, -1), (-1, 0), (2, -1)]
)
def test_linear_between_points_and_constant_beyond(load: float, value: float) -> None:
    assert Amplitude.model_validate(RAMP).value(load) == pytest.approx(value, abs=1e-15)


def test_a_motion_and_its_rotation_have_amplitudes_of_their_own() -> None:
    X = np.random.default_rng(0).standard_normal((4, 3))
    tables = [RAMP, {"name": "late", "points": [[0.5, 0], [1, 1]]}]
    move = {"move.0.translate": [1, 0, 0], "move.0.table": "ramp"}
    plain = motions_of(scenes.load("twist", **{"move.0.translate": [1, 0, 0]}))[0]
    both = motions_of(scenes.load("twist", table=[RAMP], **move))[0]
    for load in (0.0, 0.3, 0.8):
        expected = plain.displacement(X, Amplitude.model_validate(RAMP).value(load))
        assert np.array_equal(both.displacement(X, load), expected)
    apart = motions_of(
        scenes.load("twist", table=tables, **move, **{"move.0.rotate.table": "late"})
    )[0]
    np.testing.assert_allclose(apart.displacement(X, 0.25), [[1.0, 0, 0]] * 4, atol=1e-15)
    angle = motions_of(scenes.load("twist", **{"move.0.rotate.angle": np.pi / 2}))[0]
    turned = np.array([0.5, 0, 0]) + angle.displacement(X, 1.0)
    np.testing.assert_allclose(apart.displacement(X, 0.75), turned, atol=1e-15)


def test_without_a_table_the_amplitude_is_the_load() -> None:
    scene = scenes.load("cook")
    assert scene.amplitudes.force(scene.traction[0].table)(0.3) == 0.3


MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"table": [RAMP, RAMP]}, "table.name = 'ramp': expected a different name for each table"),
    ({"table": [{"name": "a", "points": [[0, 0]]}]}, r"points = \[\[0, 0\]\]: expected .* two or"),
    ({"table": [{"name": "a", "points": [[0, 0], [0, 1]]}]}, "points = .*: expected .* ascending"),
    ({"table": [{"name": "a", "points": [[0, 0], [1]]}]},
     "table.0.points = .*: expected a list of"),
    ({"move.0.table": "x"}, r"move.0.table = 'x': expected the name of a \[\[table\]\]; .* none"),
    ({"table": [RAMP], "move.0.rotate.table": "rmp"},
     "move.0.rotate.table = 'rmp': expected one of ramp .did you mean 'ramp'"),
    ({"gravity": {"vector": [0, 0, 1], "table": "g"}}, "gravity.table = 'g': expected the name"),
    ({"gravity": [1]}, "gravity = .*: expected a table"),
    ({"pressure": [{"group": "top", "value": "1"}]}, "pressure.0.value = '1': expected a finite"),
    ({"cavity": [{"group": "top", "volume": 1e300}]},
     r"cavity.0.volume = 1e\+300: expected a finite number, of a size up to 1e\+50$"),
    ({"cavity": [{"group": "top", "volume": 1, "stiffness": 1e300}]},
     r"cavity.0.stiffness = 1e\+300: expected a number > 0, of a size up to 1e\+50$"),
    ({"obstacle": [{"shape": {"plane": {"point": [0, 0, 1e200]}}}]},
     r"plane.point = \[0, 0, 1e\+200\]: expected three finite .*, of a size up to 1e\+50$"),
    ({"time": {"duration": 1e-300, "steps": 1}},
     r"time.duration = 1e-300: expected a number > 0, of a size from 1e-50$"),
    ({"time": {"duration": 1e300, "steps": 1}},
     r"time.duration = 1e\+300: expected a number > 0, of a size up to 1e\+50$"),
    ({"self_contact": {"method": "ipc", "distance": 1e300}},
     r"self_contact.distance = 1e\+300: expected a number > 0, of a size up to 1e\+50$"),
    ({"table": [{"name": "a", "points": [[0, 0], [1, 1e51]]}]},
     r"table.0.points = .*: expected .* ascending, of a size up to 1e\+50$"),
    ({"spring": [{"group": "top", "stiffness": -1}]}, "spring.0.stiffness = -1: expected a number"),
    ({"spring": [{"group": "top", "stiffness": [1, 2]}]}, "spring.0.stiffness = .*: .*or three"),
    ({"cavity": [{"group": "top", "volume": 1, "stiffness": 0}]}, "stiffness = 0: .* number > 0"),
    ({"cavity": [{"group": "top", "volume": 1}], "modes": {}}, "'cavity' and 'modes' exclude each"),
]  # fmt: skip


@pytest.mark.parametrize(("overrides", "message"), MISTAKES, ids=[str(m[0]) for m in MISTAKES])
def test_mistake_in_one_line(overrides: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=f"^twist: .*{message}") as caught:
        scenes.load("twist", **overrides)
    assert "\n" not in str(caught.value)


def test_loads_of_a_scene_file(toml: Path) -> None:
    loads = """
[gravity]
vector = [0, 0, -9.81]
[[pressure]]
group = "inner"
value = 1e3
table = "ramp"
[[spring]]
group = "top"
stiffness = [0, 0, 1e5]
[[table]]
name = "ramp"
points = [[0, 0], [1, 1], [2, 1]]
"""
    toml.write_text(TOML + loads)
    scene = scenes.load(toml)
    assert scene.gravity is not None and scene.gravity.vector == (0, 0, -9.81)
    assert (scene.pressure[0].value, scene.pressure[0].table) == (1e3, "ramp")
    assert scene.spring[0].stiffness == (0, 0, 1e5)
    assert scenes.validate(scene.model_dump(), "again") == scene
