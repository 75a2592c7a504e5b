"""The family "small_force": contact forces and loads of 1e-6 E V^(2/3), solved to 1 %."""

from __future__ import annotations

from itertools import product

from fem_snh.studies.extremes import bodies
from fem_snh.studies.extremes.cases import Case, converged, scene_case
from fem_snh.studies.extremes.tight import with_tight

LABEL, BY = "small_force-(.*)-", ()
_ELEMENTS = ("Q1", "P1", "Q1P0", "P2P0")
_FORCES = (1e-4, 1e-6)
_KINDS = ("plate", "plate-friction", "ball", "block", "traction")


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
    """Return the cases of every kind of load and element, each with a tight solve."""
    made: list[Case] = []
    for element, force, kind in product(
        _ELEMENTS[: 1 if quick else None], _FORCES[quick:], _KINDS[: 1 if quick else None]
    ):
        if force != _FORCES[-1] and element != _ELEMENTS[0]:
            continue
        by, _, friction = kind.partition("-")
        made += with_tight(
            scene_case(
                bodies.reference(bodies.touched), f"small_force-{kind}-{force:g}-{element}",
                "reaches its load in one step", converged, material,
                force=force, by=by, friction=0.5 if friction else 0.0, element=element,
                nu=0.499 if "P0" in element else 0.45, cells=2 if element[1] == "2" else 4,
            )
        )  # fmt: skip
    return made
