"""The family "small_force": contact forces and loads of 1e-6 E V^(2/3), solved to 1 %.

A cube that is loaded by 1e-4 and 1e-6 times E V^(2/3): by a plate or a large ball that sinks into
it, with and without friction, by another cube, or by a traction. The default tolerance of forces
is a fraction of this unit; forces must be right to 1 % of their own size.
"""

from __future__ import annotations

from itertools import product

from benchmarks.extremes import bodies
from benchmarks.extremes.cases import Case, converged, scene_case

_ELEMENTS = ("Q1", "P1", "Q1P0", "P2P0")
_FORCES = (1e-4, 1e-6)
_KINDS = ("plate", "plate-friction", "ball", "block", "traction")


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the cases of every kind of load and element, each with a tight solve."""
    made: list[Case] = []
    for element, force, kind in product(
        _ELEMENTS[: 1 if quick else None], _FORCES[quick:], _KINDS[: 1 if quick else None]
    ):
        if force != _FORCES[-1] and element != _ELEMENTS[0]:
            continue
        by, _, friction = kind.partition("-")
        made.append(
            scene_case(
                bodies.reference(bodies.touched), f"small_force-{kind}-{force:g}-{element}",
                "reaches its load in one step", converged,
                tight=True, force=force, by=by, friction=0.5 if friction else 0.0, element=element,
                nu=0.499 if "P0" in element else 0.45, cells=2 if element[1] == "2" else 4,
            )
        )  # fmt: skip
    return made
