"""The family "press": flattened to 1 % of the height, fast obstacles, stiff and soft penalties.

The cube of `fem-snh run press`, fixed to the ground at its bottom, under a plate that

- *flat*: sinks to 1 % of the cube's height, in ten steps or in one, with and without friction. The
  default penalty gives way by some part of the height; a penalty ten times stiffer gives way less.
- *fast*: sinks in time, at 2 and 10 times the velocity of pressure waves, sqrt(M/rho) with
  M = E (1 - nu)/((1 + nu)(1 - 2 nu)): no wave runs ahead of the plate.
- *stiff*, *soft*: sinks to half the height with a penalty 1e6 times the default one, or 1e-6 times.
  The soft one must let the plate through, whose force is then k times the depth of all points
  below it, integrated over the surface: k/2 on the top and k/2 on the sides, for a unit cube. With
  the augmented Lagrangian, which increases the stiffness, the plate must flatten the cube: no point
  is farther from it than a thousandth of a cell.

A run passes if it converges, or if it stops with a reason and keeps the steps before.
"""

from __future__ import annotations

from itertools import product
from math import sqrt
from typing import Any

from benchmarks.extremes.cases import CLEAR, Case, Check, Record, Row, ends_clearly, scene_case

#: Young's modulus [Pa] and density [kg/m^3] of the scene, and Poisson's ratio if it is not varied.
_E, _DENSITY, _NU = 1e5, 1000.0, 0.45
CELLS = 4
#: The default penalty stiffness [Pa/m]: 10 E over the size of a cell.
_DEFAULT = 10 * _E * CELLS
#: The augmented Lagrangian's default tolerance [m], a thousandth of a cell.
_TOLERANCE = 1e-3 / CELLS
_STIFFNESS = "obstacle.0.stiffness"
_SOFT = {_STIFFNESS: 1e-6 * _DEFAULT}
_HARD = {_STIFFNESS: 1e6 * _DEFAULT}
_STIFFER = {_STIFFNESS: 10 * _DEFAULT, "obstacle.1.stiffness": 10 * _DEFAULT}
_FLAT: dict[str, dict[str, Any]] = {
    "flat": {"to": 0.01, "steps": 10},
    "flat-in-one-step": {"to": 0.01, "steps": 1},
    "flat-friction": {"to": 0.01, "steps": 10, "friction": 0.5},
    "flat-stiffer": {"to": 0.01, "steps": 10, **_STIFFER},
}
_PENALTIES: dict[str, dict[str, Any]] = {
    "stiff": _HARD,
    "stiff-friction": {**_HARD, "friction": 0.5},
    "soft": _SOFT,
    "soft-augmented": {**_SOFT, "obstacle.0.method": "augmented_lagrangian"},
}
_ELEMENTS = ("Q1", "P1", "Q1P0")
#: Velocities of the plate in that of pressure waves, and time steps on its way.
_SPEEDS, _STEPS = (2.0, 10.0), 20


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the cases of every element."""
    few = 1 if quick else None
    runs = [
        (name, nu, values)
        for nu in ((_NU,) if quick else (0.3, _NU, 0.49))
        for name, values in list(_FLAT.items())[: 2 if quick else None]
    ]
    runs += [(n, _NU, v) for n, v in _PENALTIES.items() if not (quick and "friction" in n)]
    for speed, integrator in product(_SPEEDS, ("newmark", "backward_euler")):
        runs.append((f"fast-{speed:g}-{integrator}", _NU, _in_time(speed, integrator)))
    made = []
    for element, (name, nu, values) in product(_ELEMENTS[:few], runs):
        demand, check = _CHECKS.get(name, ("", ends_clearly))
        made.append(
            scene_case(
                "press", f"press-{name}-nu{nu:g}-{element}", CLEAR + demand, check,
                cells=CELLS, nu=nu, element=element, **values,
            )
        )  # fmt: skip
    return made


def _in_time(speed: float, integrator: str) -> dict[str, Any]:
    """Return the keys of a plate that sinks to half the height at a multiple of the wave speed."""
    modulus = _E * (1 - _NU) / ((1 + _NU) * (1 - 2 * _NU))
    duration = 0.5 / (speed * sqrt(modulus / _DENSITY))
    keys = {"time.duration": duration, "time.steps": _STEPS, "time.integrator": integrator}
    return {"steps": 1, "to": 0.5, **keys}


def _lets_through(record: Record, row: Row) -> str:
    """Check that a plate half-way down a cube that hardly deforms has the force k."""
    if row["converged"] is not True:
        return str(row["status"])
    force = -record["steps"][-1]["obstacles"]["plate"]["force"][2]
    expected = _SOFT[_STIFFNESS]
    close = abs(force / expected - 1) < 1e-3
    return "" if close else f"the force is {force:.4g} N instead of {expected:.4g} N"


def _flattens(record: Record, row: Row) -> str:
    """Check that no point is farther from the plate than the augmented Lagrangian's tolerance."""
    if row["converged"] is not True:
        return str(row["status"])
    depth = record["steps"][-1]["obstacles"]["plate"]["penetration"]
    return "" if depth <= _TOLERANCE else f"the penetration is {depth:.4g} m"


#: What some of `_PENALTIES` demand besides, and their checks.
_CHECKS: dict[str, tuple[str, Check]] = {
    "soft": ("; lets the plate through", _lets_through),
    "soft-augmented": ("; is flattened", _flattens),
}
