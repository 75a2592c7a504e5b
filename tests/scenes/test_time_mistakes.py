"""Mistakes in the tables of scenes in time: one line with the key and what is accepted."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import pytest
from scene_file import motions_of
from time_scenes import DOWN, SOFT

from fem_snh import scenes
from fem_snh.errors import BadInput

TIME = {"duration": 1.0, "steps": 4}
CUBE: dict[str, Any] = {
    "name": "cube", "mesh": {"source": "cube"}, "cells": 2, "element": "Q1",
    "material": SOFT.model_dump(),
}  # fmt: skip

MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"time": 2.0}, "time = 2.0: expected .*table"),
    ({"time": TIME | {"damping": {"stiffness": -1}}},
     "time.damping.stiffness = -1: expected a number >= 0"),
    ({"time": TIME | {"rho_infinity": 0.5}},
     "time.rho_infinity = 0.5: expected no value, as the integrator is newmark"),
    ({"time": TIME | {"integrator": "generalized_alpha", "rho_infinity": 1.5}},
     "time.rho_infinity = 1.5: expected a number from 0 to 1"),
    ({"time": TIME, "steps_": 1}, "unknown parameter 'steps_'"),
    ({"time": TIME, "modes": {"count": 2}}, "'time' and 'modes' exclude each other"),
    ({"time": TIME, "nu_continuation": [0.3]}, "'time' and 'nu_continuation' exclude each other"),
    ({"time": TIME, "material.density": None},
     "missing key 'material.density' of stable_neo_hookean: expected a number > 0, for .time."),
    ({"start": {"velocity": [1, 0, 0]}},
     r"start.velocity = \[1.0, 0.0, 0.0\]: expected no value, as the scene has no table .time."),
    ({"start": {"angular_velocity": [1, 0, 0]}}, "start.angular_velocity = .*: expected no value"),
    ({"time": TIME, "start": {"through": [0, 0, 0]}}, "start: missing key 'map' or 'angular_vel"),
    ({"fields": ["velocity"]}, "fields = 'velocity': expected another field, as .* no table"),
    ({"time": TIME, "fields": ["velocty"]}, "fields = 'velocty': .* .did you mean 'velocity'"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "message"), MISTAKES)
def test_a_mistake_is_one_line(keys: dict[str, Any], message: str) -> None:
    before = deepcopy(CUBE)
    with pytest.raises(BadInput, match=message) as found:
        scenes.validate(CUBE, "cube", keys)
    assert before == CUBE  # the caller's tables remain as they are
    assert "\n" not in str(found.value) and str(found.value).startswith("cube: ")


def test_a_scene_has_one_number_of_steps() -> None:
    """``steps`` of the scene is for load steps; as an option it means the time steps."""
    with pytest.raises(BadInput, match=r"steps = 3: expected no value, as \[time\] has its own"):
        scenes.validate(CUBE | {"time": TIME, "steps": 3}, "cube")
    scene = scenes.validate(CUBE | {"time": TIME}, "cube")
    for keys, steps in (({"steps": 7}, 7), ({"time.steps": 9}, 9)):
        time = scenes.load(scene, **keys).time
        assert time is not None and time.steps == steps
    assert scenes.load(scene, steps=7).steps == 1


def test_amplitudes_are_in_time() -> None:
    """Of forces 1 without a table; of motions and fluids the fraction of the duration."""
    table = [{"name": "t", "points": [[0, 0], [4, 8]]}]
    move = {"group": "left", "translate": [1, 0, 0]}
    tables = {
        "time": TIME | {"duration": 2.0},
        "table": table,
        "gravity": DOWN.model_dump(),
        "pressure": [{"group": "top", "value": 1.0, "table": "t"}],
        "cavity": [{"group": "top", "volume": 1.0}],
        "move": [move, {"group": "right", "translate": [1, 0, 0], "table": "t"}],
    }
    scene = scenes.validate(CUBE | tables, "cube")
    assert scene.gravity is not None and scene.duration == 2.0
    gravity = scene.amplitudes.force(scene.gravity.table)
    pressure = scene.amplitudes.force(scene.pressure[0].table)
    fluid = scene.amplitudes.motion(scene.cavity[0].table)
    assert [gravity(load) for load in (0.0, 0.5)] == [1.0, 1.0]
    assert [pressure(load) for load in (0.0, 0.5, 1.0)] == [0.0, 2.0, 4.0]
    assert fluid(0.25) == 0.25
    assert [m.amplitude(0.25) for m in motions_of(scene)] == [0.25, 1.0]
    assert scene.amplitudes.force("t") == pressure
