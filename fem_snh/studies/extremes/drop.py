"""The family "drop": a ball dropped from 100 diameters, and time steps 100 times too long."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.scenes.builtin.bounce import GRAVITY, RADIUS
from fem_snh.studies.extremes.cases import Case, Record, Row, scene_case
from fem_snh.studies.extremes.outcomes import CLEAR, ends_clearly, table
from fem_snh.studies.extremes.pictures import Picture, body_picture

title = "Dropped from 100 diameters"
#: Height of the fall in diameters of the ball.
HEIGHTS = 100
#: Velocity of the impact [m/s].
SPEED = sqrt(2 * GRAVITY * HEIGHTS * 2 * RADIUS)
about = f"""\
The ball of `fem-snh run bounce`, dropped from {HEIGHTS} times its diameter: it meets the ground at
{SPEED:.1f} m/s. With E = 1e5 Pa this is 4.4 times the velocity of waves in a bar, sqrt(E/rho) =
10 m/s, and the kinetic energy per volume is 10 E; with E = 1e7 Pa it is 0.44 times that velocity.
The second group of runs falls from half a diameter with time steps of 0.5 s, 100 times those of the
scene, so that the whole impact happens within a step.

A run passes if it converges, or if it stops with a reason and keeps the steps before. Backward
Euler's energy must not grow, either: kinetic, elastic and potential energy together stay below the
energy at the start."""

#: Steps during the impact: two thousandths of a second each for the soft ball, one for the other.
_IMPACTS: dict[str, dict[str, Any]] = {
    "soft": {"E": 1e5, "time.duration": 0.1, "time.steps": 50},
    "stiff": {"E": 1e7, "time.duration": 0.04, "time.steps": 40},
}
#: Distance from the ground at the start [m].
_GAP = 0.02
_ELEMENTS = ("P1", "P2", "P2P0")
_INTEGRATORS = ("backward_euler", "newmark", "bdf2", "generalized_alpha")
_LONG = {"time.duration": 1.0, "time.steps": 2}
CELLS = 4
#: Growth of the energy, relative to that of the start or 1 J, that the solver's tolerance explains.
_GROWTH = 1e-6


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
    """Return the impacts and the long steps of every element and integrator."""
    integrators = _INTEGRATORS[:2] if quick else _INTEGRATORS
    falling = {"height": _GAP, "start.velocity": [0.0, 0.0, -SPEED]}
    made = []
    for integrator in integrators:
        for name, values in _IMPACTS.items():
            made.append(_case(name, 0.4, "P1", integrator, {**falling, **values}, material))
        made.append(_case("long-step", 0.4, "P1", integrator, _LONG, material))
    if quick:
        return made
    for element, nu in ((element, nu) for element in _ELEMENTS for nu in (0.4, 0.49)):
        if (element, nu) != ("P1", 0.4):
            values = {**falling, **_IMPACTS["stiff"]}
            made.append(_case("stiff", nu, element, "backward_euler", values, material))
    return [*made, _case("long-step", 0.4, "P1", "semi_implicit", _LONG, material)]


def _case(
    name: str, nu: float, element: str, integrator: str, values: dict[str, Any], material: str
) -> Case:
    own = {"material": material} if material else {}
    dissipative = integrator == "backward_euler"
    return scene_case(
        "bounce",
        f"drop-{name}-nu{nu:g}-{element}-{integrator}",
        f"{CLEAR}; its energy does not grow" if dissipative else CLEAR,
        _no_growth if dissipative else ends_clearly,
        required=not material,
        cells=CELLS, nu=nu, element=element, **values, **{"time.integrator": integrator}, **own,
    )  # fmt: skip


def _no_growth(record: Record, row: Row) -> str:
    """Check for a clear end, and for an energy that never exceeds that of the start."""
    if reason := ends_clearly(record, row):
        return reason
    start = record["time"]["start"]["energy"]
    most = max(step["energy"] for step in record["steps"] if step["converged"])
    grows = most > start + _GROWTH * max(abs(start), 1.0)
    return f"its energy grows to {most:.6g} J" if grows else ""


def tables(rows: pd.DataFrame) -> str:
    """Return a line for each run."""
    return table(rows, "drop")


def pictures(out: Path) -> list[Picture]:
    """Return the soft ball during its impact."""
    case = "drop-soft-nu0.4-P1-backward_euler"
    if not ((out / case).exists() or (out / "drop.png").exists()):
        return []
    panels = [(case, t, f"{1000 * t:g} ms") for t in (0.0, 0.02, 0.1)]
    caption = f"A ball that meets the ground at {SPEED:.1f} m/s, E = 1e5 Pa."
    return [body_picture(out, "drop.png", panels, caption)]
