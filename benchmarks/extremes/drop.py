"""The family "drop": a ball dropped from 100 diameters, and time steps 100 times too long.

The ball of `fem-snh run bounce`, dropped from 100 times its diameter: it meets the ground at
44.3 m/s. With E = 1e5 Pa this is 4.4 times the velocity of waves in a bar, sqrt(E/rho) =
10 m/s, and the kinetic energy per volume is 10 E; with E = 1e7 Pa it is 0.44 times that velocity.
The second group of runs falls from half a diameter with time steps of 0.5 s, 100 times those of the
scene, so that the whole impact happens within a step.

A run passes if it converges, or if it stops with a reason and keeps the steps before. Backward
Euler's energy must not grow, either: kinetic, elastic and potential energy together stay below the
energy at the start.
"""

from __future__ import annotations

from itertools import product
from math import sqrt
from typing import Any

from benchmarks.extremes.cases import CLEAR, Case, Record, Row, ends_clearly, scene_case
from fem_snh.scenes.builtin.bounce import GRAVITY, RADIUS

#: Height of the fall in diameters of the ball.
HEIGHTS = 100
#: Velocity of the impact [m/s].
SPEED = sqrt(2 * GRAVITY * HEIGHTS * 2 * RADIUS)
_FALLING = {"height": 0.02, "start.velocity": [0.0, 0.0, -SPEED]}  # the gap to the ground [m]
#: Steps during the impact: two thousandths of a second each for the soft ball, one for the other.
_IMPACTS: dict[str, dict[str, Any]] = {
    "soft": {**_FALLING, "E": 1e5, "time.duration": 0.1, "time.steps": 50},
    "stiff": {**_FALLING, "E": 1e7, "time.duration": 0.04, "time.steps": 40},
    "long-step": {"time.duration": 1.0, "time.steps": 2},
}
_ELEMENTS = ("P1", "P2", "P2P0")
_INTEGRATORS = ("backward_euler", "newmark", "bdf2", "generalized_alpha")
CELLS = 4
#: Growth of the energy, relative to that of the start or 1 J, that the solver's tolerance explains.
_GROWTH = 1e-6


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the impacts and the long steps of every element and integrator."""
    first = product(_INTEGRATORS[: 2 if quick else None], _IMPACTS, [("P1", 0.4)])
    more = [(_INTEGRATORS[0], "stiff", e) for e in product(_ELEMENTS, (0.4, 0.49))]
    more = [("semi_implicit", "long-step", ("P1", 0.4)), *more[1:]]
    made = []
    for integrator, name, (element, nu) in [*first, *([] if quick else more)]:
        dissipative = integrator == "backward_euler"
        made.append(
            scene_case(
                "bounce",
                f"drop-{name}-nu{nu:g}-{element}-{integrator}",
                f"{CLEAR}; its energy does not grow" if dissipative else CLEAR,
                _no_growth if dissipative else ends_clearly,
                cells=CELLS, nu=nu, element=element,
                **_IMPACTS[name], **{"time.integrator": integrator},
            )
        )  # fmt: skip
    return made


def _no_growth(record: Record, row: Row) -> str:
    """Check for a clear end, and for an energy that never exceeds that of the start."""
    if reason := ends_clearly(record, row):
        return reason
    start = record["time"]["start"]["energy"]
    most = max(step["energy"] for step in record["steps"] if step["converged"])
    grows = most > start + _GROWTH * max(abs(start), 1.0)
    return f"its energy grows to {most:.6g} J" if grows else ""
