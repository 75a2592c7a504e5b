"""The family "loads": large loads in a single step (stretch, compression, twist).

The cylinder of Smith et al. 2018 stretched or compressed, and their cube twisted, in one step. A
turn by 2 pi in one step is the identity on the boundary: the body is at rest and must stay there.
4 pi in eight steps, each of which is a quarter turn, can end in either of two states: twisted
twice, or at rest, as a rotation by 4 pi can be undone without turning the ends back. A step that
had to be halved fails. Where a body has several equilibria, the path decides which one is found:
compare the energies.

At nu = 0.4999 the element is Q1P0 and the steps start with nu = 0.49 (`nu_continuation = [0.49]`).
Q1 locks there (docs/results/elements.md), and has many states in which a descent stalls. Q1 at this
nu, Q1P0 without continuation, and the trust region may fail; they are run for comparison.
"""

from __future__ import annotations

from itertools import product
from math import pi
from typing import Any

from benchmarks.extremes.cases import (
    POLICIES,
    REST_TOLERANCE,
    Case,
    Record,
    Row,
    converged,
    scene_case,
)

NUS = (0.3, 0.49, 0.4999)
#: From this nu on Q1 locks and Q1P0 takes its place.
LOCKING_NU = 0.4999
#: Poisson's ratios at which steps start from `LOCKING_NU` on.
START_NUS = (0.49,)
#: Cells along the edge or diameter.
CELLS = 6
#: Limit on the Newton iterations of the twist by pi in a trust region, at these nu and cells.
TRUST_LIMIT = 40
TRUST_NUS = (0.3, 0.49)
TRUST_CELLS = (8, 10, 12, 15)

_LOADS: dict[str, tuple[str, dict[str, Any]]] = {
    "stretch-3.4": ("stretch", {"stretch": 3.4}),
    "stretch-10": ("stretch", {"stretch": 10.0}),
    "compress-0.05": ("stretch", {"stretch": 0.05}),
    "twist-half-pi": ("twist", {"angle": pi / 2}),
    "twist-pi": ("twist", {"angle": pi}),
    "twist-2pi": ("twist", {"angle": 2 * pi}),
    "twist-4pi-in-8": ("twist", {"angle": 4 * pi, "steps": 8}),
}


def cases(quick: bool, seeds: int) -> list[Case]:
    """Return the cases of every load at every nu, and the runs for comparison."""

    def case(
        name: str,
        nu: float,
        cells: int = CELLS,
        policy: str = "adaptive",
        element: str = "",
        required: bool = True,
    ) -> Case:
        """Return the case of a load; an ``element`` is run without continuation."""
        scene, values = _LOADS[name]
        start = list(START_NUS) if nu >= LOCKING_NU and not element else []
        element = element or ("Q1P0" if nu >= LOCKING_NU else "Q1")
        criterion, check = "reaches its load", converged
        if required and policy == "trust":
            criterion, check = f"{criterion} in at most {TRUST_LIMIT} Newton iterations", _few
        elif name == "twist-2pi":
            criterion, check = "stays at rest", _stays_at_rest
        full = {"steps": 1, **values, "predictor": "none", "petsc.snes_max_it": 1000}
        full |= {"cells": cells, "nu": nu, "element": element, "nu_continuation": start}
        name = f"loads-{name}-nu{nu:g}-{element}-{cells}-{policy}"
        name += "-continuation" if start else ""
        full |= POLICIES[policy]
        return scene_case(scene, name, criterion, check, required, **full)

    if quick:
        some = ("stretch-3.4", "twist-half-pi", "twist-2pi")
        return [case(name, nu, 4) for name, nu in product(some, (0.3, 0.49))]
    made = [case(name, nu) for name, nu in product(_LOADS, NUS)]
    return [
        *made,
        *(case("twist-pi", nu, cells, "trust") for nu, cells in product(TRUST_NUS, TRUST_CELLS)),
        *(
            case(name, LOCKING_NU, element=element, required=False)
            for element, name in product(("Q1P0", "Q1"), _LOADS)
        ),
        *(case(name, nu, CELLS, "trust", required=False) for name, nu in product(_LOADS, NUS)),
    ]


def _stays_at_rest(record: Record, row: Row) -> str:
    reason = converged(record, row)
    return reason or ("" if row["max_u"] < REST_TOLERANCE else f"it moved by {row['max_u']:.2g}")


def _few(record: Record, row: Row) -> str:
    reason = converged(record, row)
    few = row["newton"] <= TRUST_LIMIT
    return reason or ("" if few else f"{row['newton']} Newton iterations")
