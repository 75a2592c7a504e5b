"""The scenes of which the exact values of goals are known, for benchmarks of accuracy.

``exact_goals.json`` has the values; `benchmarks.exact_goals` makes them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import pi
from pathlib import Path
from typing import Any

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Probe, Reaction, Scene, Traction, load

#: The values, with the command that makes them.
DATA = Path(__file__).with_name("exact_goals.json")
#: Young's modulus of the bracket, and the dead load on the end of its arm, per area.
MODULUS, LOAD = 1.0, 0.002


@dataclass(frozen=True)
class Case:
    """A scene and a goal of it.

    Attributes
    ----------
    scene : callable
        Of overrides such as ``element`` and ``cells``: the scene.
    goal : str
        The goal, as in ``[accuracy]``.
    ladder : tuple of int
        Cells of uniform meshes of elements of degree 1; those of degree 2 have half of them.
    corner : bool
        Whether the error is at a re-entrant corner.
    """

    scene: Callable[..., Scene]
    goal: str
    ladder: tuple[int, ...]
    corner: bool = False


def bracket(nu: float = 0.3, **options: Any) -> Scene:
    """A bracket that is clamped at its foot and bent by a dead load on the end of its arm."""
    plane = options.get("kinematics") is not None
    z = 0.0 if plane else 0.5
    given: dict[str, Any] = {"element": "Q2", "cells": 4, **options}
    return Scene(
        name="bracket",
        mesh=Geometry(source="bracket"),
        steps=2,
        material=MaterialChoice(name="stable_neo_hookean", E=MODULUS, nu=nu),
        hold=[Hold(group="bottom")],
        traction=[Traction(group="end", vector=(0, -LOAD, 0))],
        probe=[Probe(name="tip", point=(3, 3, z))],
        **given,
    )


def built_in(name: str, **fixed: Any) -> Callable[..., Scene]:
    """Return the function that loads a built-in scene with some options."""
    return lambda **options: load(name, **{**fixed, **options})


def stretch(**options: Any) -> Scene:
    """The stretch of a cylinder that is round: its cells are curved."""
    scene = load("stretch", **options)
    assert isinstance(scene.mesh, Geometry)
    parameters = {**scene.mesh.parameters, "order": 2}
    return scene.model_copy(
        update={"mesh": scene.mesh.model_copy(update={"parameters": parameters})}
    )


def twist(**options: Any) -> Scene:
    """The quarter turn of the cube in two steps, with its moment."""
    scene = load("twist", angle=pi / 2, **options)
    about = Reaction(group="top", about=(0.5, 0.5, 1.0))
    return scene.model_copy(update={"reactions": [about]})


def elbow(**options: Any) -> Scene:
    """The flexed elbow, whose cells are curved, with its energy."""
    return load("elbow", order=2, **options)


def hertz(**options: Any) -> Scene:
    """The ball that is pressed by a plane, with the force on its middle."""
    return load("hertz", **options).model_copy(update={"reactions": [Reaction(group="z = 0")]})


CASES = {
    "cook, nu 0.3": Case(built_in("cook", nu=0.3), "corner.y", (8, 16, 32, 64, 128), corner=True),
    "cook, nu 0.4999": Case(
        built_in("cook", nu=0.4999), "corner.y", (8, 16, 32, 64, 128), corner=True
    ),
    "stretch": Case(stretch, "right.force.x", (4, 6, 8, 12, 16, 24)),
    "quarter turn": Case(twist, "top.moment.z", (4, 6, 8, 12, 16, 24)),
    "bracket": Case(bracket, "tip.y", (2, 4, 6, 8, 12, 16), corner=True),
    "elbow": Case(elbow, "energy", (24, 36, 48, 64, 80)),
    "hertz": Case(hertz, "z = 0.force.z", (2, 4, 6, 8, 12, 16)),
}


@cache
def exact(case: str) -> tuple[float, float]:
    """Return the exact value of a case's goal, and its uncertainty, relative."""
    found = json.loads(DATA.read_text(encoding="utf-8"))["values"][case]
    return float(found["value"]), float(found["uncertainty"])


def goals_of(step: dict[str, Any]) -> dict[str, float]:
    """Return the goals that a row of a step has."""
    found = {"energy": step["energy"], "volume": step["volume_ratio"]}
    kinds = {"probes": "", "reactions": ".force", "moments": ".moment"}
    for key, kind in kinds.items():
        for name, vector in step.get(key, {}).items():
            components = zip("xyz", vector, strict=False)
            found |= {f"{name}{kind}.{axis}": value for axis, value in components}
    for name, state in step.get("rigid", {}).items():
        components = zip("xyz", state["rotation"], strict=True)
        found |= {f"{name}.rotation.{axis}": value for axis, value in components}
    return found
