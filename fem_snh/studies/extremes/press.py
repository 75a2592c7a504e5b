"""The family "press": flattened to 1 % of the height, fast obstacles, stiff and soft penalties."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.studies.extremes.cases import Case, Check, Record, Row, scene_case
from fem_snh.studies.extremes.outcomes import CLEAR, ends_clearly, table
from fem_snh.studies.extremes.pictures import Picture, body_picture

title = "Pressed flat"
about = """\
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

A run passes if it converges, or if it stops with a reason and keeps the steps before."""

#: Young's modulus [Pa] and density [kg/m^3] of the scene.
_E, _DENSITY = 1e5, 1000.0
CELLS = 4
#: The default penalty stiffness [Pa/m]: 10 E over the size of a cell.
_DEFAULT = 10 * _E * CELLS
_STIFFNESS = "obstacle.0.stiffness"
#: The augmented Lagrangian's default tolerance [m], a thousandth of a cell.
_TOLERANCE = 1e-3 / CELLS
_SOFT = {_STIFFNESS: 1e-6 * _DEFAULT}
_FLAT: dict[str, dict[str, Any]] = {
    "flat": {"steps": 10},
    "flat-in-one-step": {"steps": 1},
    "flat-friction": {"steps": 10, "friction": 0.5},
    "flat-stiffer": {
        "steps": 10,
        _STIFFNESS: 10 * _DEFAULT,
        "obstacle.1.stiffness": 10 * _DEFAULT,
    },
}
_PENALTIES: dict[str, dict[str, Any]] = {
    "stiff": {_STIFFNESS: 1e6 * _DEFAULT},
    "stiff-friction": {_STIFFNESS: 1e6 * _DEFAULT, "friction": 0.5},
    "soft": _SOFT,
    "soft-augmented": {**_SOFT, "obstacle.0.method": "augmented_lagrangian"},
}
_ELEMENTS = ("Q1", "P1", "Q1P0")
#: Poisson's ratio of the runs whose nu is not varied.
_NU = 0.45
#: Velocities of the plate in that of pressure waves, and time steps on its way.
_SPEEDS, _STEPS = (2.0, 10.0), 20


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
    """Return the cases of every element."""
    made = []
    for element in _ELEMENTS[: 1 if quick else None]:
        for nu in (_NU,) if quick else (0.3, _NU, 0.49):
            for name, values in list(_FLAT.items())[: 2 if quick else None]:
                flat = {"to": 0.01, **values}
                made.append(_case(name, nu, element, flat, ends_clearly, material))
        for name, values in _PENALTIES.items():
            if quick and "friction" in name:
                continue
            check = _CHECKS.get(name, ends_clearly)
            made.append(_case(name, _NU, element, values, check, material))
        for speed in _SPEEDS:
            for integrator in ("newmark", "backward_euler"):
                name, values = f"fast-{speed:g}-{integrator}", _in_time(speed, integrator)
                made.append(_case(name, _NU, element, values, ends_clearly, material))
    return made


def _in_time(speed: float, integrator: str) -> dict[str, Any]:
    """Return the keys of a plate that sinks to half the height at a multiple of the wave speed."""
    modulus = _E * (1 - _NU) / ((1 + _NU) * (1 - 2 * _NU))
    duration = 0.5 / (speed * sqrt(modulus / _DENSITY))
    keys = {"time.duration": duration, "time.steps": _STEPS, "time.integrator": integrator}
    return {"steps": 1, "to": 0.5, **keys}


def _case(
    name: str, nu: float, element: str, values: dict[str, Any], check: Check, material: str
) -> Case:
    own = {"material": material} if material else {}
    criterion = "; ".join([CLEAR, *([_CRITERIA[check]] if check in _CRITERIA else [])])
    return scene_case(
        "press", f"press-{name}-nu{nu:g}-{element}", criterion, check,
        required=not material, cells=CELLS, nu=nu, element=element, **values, **own,
    )  # fmt: skip


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


#: The checks of some of `_PENALTIES`, and what they demand.
_CHECKS: dict[str, Check] = {"soft": _lets_through, "soft-augmented": _flattens}
_CRITERIA: dict[Check, str] = {_lets_through: "lets the plate through", _flattens: "is flattened"}


def tables(rows: pd.DataFrame) -> str:
    """Return a line for each run."""
    return table(rows, "press")


def pictures(out: Path) -> list[Picture]:
    """Return the flattened cube."""
    case = f"press-flat-stiffer-nu{_NU:g}-Q1"
    if not ((out / case).exists() or (out / "press.png").exists()):
        return []
    panels = [(case, load, f"{100 - 99 * load:.0f} %") for load in (0.0, 0.5, 1.0)]
    return [body_picture(out, "press.png", panels, "Pressed to 1 % of its height, nu = 0.45.")]
