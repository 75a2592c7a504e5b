"""Is what was asked for true of random scenes? Bodies in the plane, compared with finer meshes.

Brackets with a re-entrant corner and Cook's membrane, in plane strain and plane stress, with loads,
ratios, materials, elements and meshes that are drawn at random. Every displacement, force and the
energy is a goal.
"""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import Any

import fem_snh
from benchmarks import Row
from fem_snh.scenes import Scene

_RATIOS = (0.0, 0.2, 0.3, 0.35, 0.4, 0.45, 0.48, 0.49, 0.495, 0.499, 0.4999)
_MATERIALS = ("stable_neo_hookean", "neo_hookean", "neo_hookean_simo")
_ELEMENTS = ("P1", "P2", "P2P0", "P2P1", "Q1", "Q1P0", "Q2", "Q2Q1")
_OF_SHEETS = ("P1", "P2", "Q1", "Q2")


def rows(
    first: int = 0, count: int = 20, share: float = 0.01, finer: float = 20.0, max_time: float = 60
) -> Iterator[Row]:
    """Yield one row for each scene; then a summary.

    Parameters
    ----------
    first, count : int
        The first seed, and the number of scenes.
    share : float
        The accuracy that is asked for.
    finer : float
        The values that are compared with are those of runs to this part of it.
    max_time : float
        Longest run [s].

    Yields
    ------
    dict
        The scene; ``goals``, how many are within the accuracy according to the run and known ten
        times better from the finer one; ``largest``, their largest true error; ``within``, how many
        are within their own bounds.
    """
    found: list[tuple[float, float]] = []
    for seed in range(first, first + count):
        scene, goals = random_scene(Random(seed))
        coarse, fine = (_goals(scene, goals, within, max_time) for within in (share, share / finer))
        errors = []
        for name, goal in coarse.items():
            exact = fine.get(name)
            if not exact or exact["uncertainty"] > 0.1 * goal["uncertainty"]:
                continue
            error = abs(goal["best"] - exact["best"])
            if goal["relative"] <= share:
                errors.append((error / abs(exact["best"]), error / goal["uncertainty"]))
        found += errors
        yield {"seed": seed, "scene": scene.name, "element": scene.element} | _summary(
            errors, share
        )
    yield {"summary": count} | _summary(found, share)


def _summary(errors: list[tuple[float, float]], share: float) -> Row:
    largest = max((error for error, _ in errors), default=None)
    return {
        "goals": len(errors),
        "largest": largest,
        "within": sum(over <= 1 for _, over in errors),
        "ok": largest is None or largest <= share,
    }


def _goals(scene: Scene, goals: list[str], within: float, max_time: float) -> dict[str, Any]:
    accuracy = {"goals": goals, "within": within, "max_time": max_time}
    result = fem_snh.run(scene, accuracy=accuracy, progress=False)
    known: dict[str, Any] = result.record["accuracy"]["levels"][-1]["goals"]
    return known


def random_scene(draw: Random) -> tuple[Scene, list[str]]:
    """Return a scene and the names of its goals."""
    kinematics = draw.choice(("plane_strain", "plane_stress"))
    elements = _OF_SHEETS if kinematics == "plane_stress" else _ELEMENTS
    scene: dict[str, Any] = {
        "kinematics": kinematics, "element": draw.choice(elements), "steps": 4,
        "material": {"name": draw.choice(_MATERIALS), "E": 1.0, "nu": draw.choice(_RATIOS)},
    }  # fmt: skip
    across = draw.uniform(-1, 1)
    if draw.random() < 0.5:
        scene |= {"name": "bracket", "mesh": {"source": "bracket"}, "cells": draw.choice((1, 2))}
        size, foot = draw.uniform(5e-4, 6e-3), "bottom"
        if draw.random() < 0.6:
            scene["traction"] = [{"group": "end", "vector": [0.7 * size * across, -size, 0]}]
        else:
            scene["move"] = [{"group": "end", "translate": [70 * size * across, -100 * size, 0]}]
        points = {"tip": (3, 3, 0), "knee": (1, 2, 0)}
    else:
        scene |= {"name": "cook", "mesh": {"source": "cook"}, "cells": draw.choice((2, 4))}
        size, foot = draw.uniform(2e-3, 3e-2), "left"
        scene["traction"] = [{"group": "right", "vector": [0.2 * size * across, size, 0]}]
        points = {"corner": (48, 60, 0)}
    scene |= {
        "hold": [{"group": foot}], "reactions": [foot],
        "probe": [{"name": name, "point": point} for name, point in points.items()],
    }  # fmt: skip
    goals = [f"{name}.{axis}" for name in (*points, f"{foot}.force") for axis in "xy"]
    return Scene.model_validate(scene), ["energy", *goals]
