"""Motions with a required accuracy: what it takes, and the true error of the goal."""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter
from typing import Any

import fem_snh
from benchmarks import Row, split_list
from fem_snh import scenes
from fem_snh.scenes import Geometry, Gravity, Hold, MaterialChoice, Probe, Scene, Time
from fem_snh.scenes.schema import Accuracy

_GOALS = {"swing": "tip.z", "bounce": "body.mean.z"}
#: Levels end before one that would take longer [s].
_MAX_TIME = 900.0


def rows(
    scenes: str = "swing,bounce", within: float = 0.01, finer: float = 2.0, shorter: float = 2.0
) -> Iterator[Row]:
    """Yield one row per scene and level, and one with the true error of the last.

    Parameters
    ----------
    scenes : str
        swing: a cantilever that falls from rest; bounce: a ball that falls and bounces.
    within : float
        The accuracy that is asked for.
    finer, shorter : float
        The reference has cells and time steps so many times smaller than the last level.

    Yields
    ------
    dict
        ``value``, ``error``, ``corrected``, ``uncertainty`` of the goal; in the last row ``exact``,
        the reference with its own estimated errors added, and ``true_error`` of the better value.
    """
    for name in split_list(scenes):
        goal, start = _GOALS[name], perf_counter()
        asked = Accuracy(goals=[goal], within=within, max_time=_MAX_TIME)
        result = fem_snh.run(_scene(name, accuracy=asked), progress=False)
        seconds, record = perf_counter() - start, result.record["accuracy"]
        for level in record["levels"]:
            about = {key: level[key] for key in ("cells", "dofs", "time_steps", "seconds")}
            yield {"scene": name, "goal": goal} | about | level["goals"].get(goal, {})
        last = record["levels"][-1]
        cells = round(last["cells"] ** (1 / 3) * finer)
        yield {
            "scene": name,
            "reached": record["reached"],
            "seconds": seconds,
            **_truth(name, goal, cells, last, shorter),
        }


def _truth(name: str, goal: str, cells: int, last: Any, shorter: float) -> Row:
    """Return the reference, and the error of the last level against it."""
    scene = _scene(name, accuracy=Accuracy(goals=[goal]))
    assert scene.time is not None
    steps = round(last["time_steps"] * shorter)
    found = fem_snh.run(
        scene.model_copy(
            update={
                "cells": cells if name == "bounce" else max(3, cells // 2),
                "time": scene.time.model_copy(update={"steps": steps}),
            }
        ),
        progress=False,
    ).goals[goal]
    exact, level = found["corrected"], last["goals"][goal]
    assert exact is not None
    left = {key: abs(level[key] - exact) / abs(exact) for key in ("value", "corrected")}
    best = min((abs(level["error"]), "value"), (level["uncertainty"] or 1e300, "corrected"))[1]
    return {"exact": exact, "exact_error": found["relative"], "true_error": left[best]}


def _scene(name: str, **keys: Any) -> Scene:
    if name == "bounce":
        return scenes.load("bounce").model_copy(update=keys)
    return Scene(
        name="swing",
        mesh=Geometry(source="bar", parameters={"length": 5.0, "interface": 2.5}),
        cells=4,
        element="Q1P0",
        material=MaterialChoice(name="stable_neo_hookean", E=1e7, nu=0.45, density=1000.0),
        hold=[Hold(group="left")],
        gravity=Gravity(vector=(0, 0, -9.81)),
        probe=[Probe(name="tip", point=(5, 0.5, 0.5))],
        time=Time(duration=1.0, steps=40),
        **keys,
    )
