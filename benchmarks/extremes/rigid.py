"""The family "rigid": rigid parts that turn by angles up to 2 pi in one step.

*end*: the rigid half of a bar turns about its axis; *sphere*, *bar*: a rigid inclusion of a cube
whose ends are held turns about an axis across them; by angles up to 2 pi in one step. *torque*: the
half is free, with a torque of up to 0.1 times E and the cube of the width. Each has a tight solve
as for stiff inclusions.
"""

from __future__ import annotations

from math import pi
from typing import Any

from benchmarks.extremes import bodies
from benchmarks.extremes.cases import Case, converged, scene_case

#: Angles of one step [rad]; at pi the axis of the turn has no sign.
_ANGLES = {"half-pi": pi / 2, "0.9pi": 0.9 * pi, "1.5pi": 1.5 * pi, "2pi": 2 * pi}
#: Torques over E of a free part: of the width's cube, so the last twists the bar by some radians.
_TORQUES = (1e-6, 1e-2, 0.1)
_ELEMENTS = ("Q1", "P1", "P2P0")


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the cases of every angle and element, each with a tight solve."""
    runs: dict[str, tuple[Any, dict[str, Any]]] = {}
    for name, angle in _ANGLES.items():
        runs[f"end-{name}"] = bodies.turned, {"angle": angle}
        for shape in ("sphere", "bar"):
            runs[f"{shape}-{name}"] = bodies.inclusion, {"shape": shape, "rigid": angle}
    for torque in _TORQUES:
        runs[f"torque-{torque:g}"] = bodies.turned, {"torque": torque}
    made: list[Case] = []
    for element in _ELEMENTS[: 1 if quick else None]:
        for name, (scene, keys) in runs.items():
            if quick and name not in ("end-2pi", "bar-0.9pi", "torque-0.01"):
                continue
            if "sphere" in name and element != _ELEMENTS[0]:
                continue
            nu = 0.499 if "P0" in element else 0.45
            cells = {"1": 4, "2": 2}[element[1]] * (2 if scene is bodies.inclusion else 1)
            made.append(
                scene_case(
                    bodies.reference(scene), f"rigid-{name}-{element}",
                    "reaches its load in one step", converged,
                    element != "P2P0" or "torque" in name,  # unstable equilibria
                    element=element, tight=True, nu=nu, cells=cells // (2 if quick else 1), **keys,
                )
            )  # fmt: skip
    return made
