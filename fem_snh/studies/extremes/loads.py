"""The family "loads": large loads in a single step (stretch, compression, twist)."""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.studies.extremes.cases import (
    POLICIES,
    REST_TOLERANCE,
    Case,
    Check,
    Record,
    Row,
    converged,
    scene_case,
)
from fem_snh.studies.extremes.pictures import Picture, body_picture
from fem_snh.studies.markdown import markdown_table

title = "Large loads in one step"
about = """\
The cylinder of Smith et al. 2018 stretched or compressed, and their cube twisted, in one step. A
turn by 2 pi in one step is the identity on the boundary: the body is at rest and must stay there.
4 pi in eight steps, each of which is a quarter turn, can end in either of two states: twisted
twice, or at rest, as a rotation by 4 pi can be undone without turning the ends back. A step that
had to be halved fails. Where a body has several equilibria, the path decides which one is found:
compare the energies.

At nu = 0.4999 the element is Q1P0 and the steps start with nu = 0.49 (`nu_continuation = [0.49]`).
Q1 locks there (docs/results/elements.md), and has many states in which a descent stalls. Q1 at this
nu, Q1P0 without continuation, and the trust region may fail; they are run for comparison."""

NUS = (0.3, 0.49, 0.4999)
#: From this nu on Q1 locks and Q1P0 takes its place.
LOCKING_NU = 0.4999
#: Poisson's ratios at which steps start from `LOCKING_NU` on.
START_NUS = [0.49]
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


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
    """Return the cases of every load at every nu, and the runs for comparison."""
    own: dict[str, Any] = {"material": material} if material else {}
    if quick:
        loads = ("stretch-3.4", "twist-half-pi", "twist-2pi")
        return [_case(name, nu, 4, **own) for name in loads for nu in (0.3, 0.49)]
    made = [_case(name, nu, CELLS, **own) for name in _LOADS for nu in NUS]
    if own:
        return made
    made += [
        _case("twist-pi", nu, cells, policy="trust") for nu in TRUST_NUS for cells in TRUST_CELLS
    ]
    plain = [
        _case(name, LOCKING_NU, CELLS, element=element, nu_continuation=[], required=False)
        for element in ("Q1P0", "Q1")
        for name in _LOADS
    ]
    trust = [
        _case(name, nu, CELLS, policy="trust", required=False) for name in _LOADS for nu in NUS
    ]
    return made + plain + trust


def _case(
    name: str,
    nu: float,
    cells: int,
    *,
    element: str = "",
    policy: str = "adaptive",
    nu_continuation: list[float] | None = None,
    required: bool = True,
    **own: Any,
) -> Case:
    scene, values = _LOADS[name]
    element = element or ("Q1P0" if nu >= LOCKING_NU else "Q1")
    nu_continuation = (
        START_NUS if nu_continuation is None and nu >= LOCKING_NU else nu_continuation or []
    )
    check: Check = _stays_at_rest if name == "twist-2pi" else converged
    criterion = "stays at rest" if name == "twist-2pi" else "reaches its load"
    if required and policy == "trust":
        check = _few_iterations
        criterion = f"reaches its load in at most {TRUST_LIMIT} Newton iterations"
    full = {"steps": 1, **values, "predictor": "none", "petsc.snes_max_it": 1000}
    full |= {
        "cells": cells,
        "nu": nu,
        "element": element,
        **POLICIES[policy],
        "nu_continuation": nu_continuation,
    }
    point = f"loads-{name}-nu{nu:g}-{element}-{cells}-{policy}" + (
        "-continuation" if nu_continuation else ""
    )
    return scene_case(scene, point, criterion, check, required=required and not own, **full, **own)


def _stays_at_rest(record: Record, row: Row) -> str:
    reason = converged(record, row)
    return reason or ("" if row["max_u"] < REST_TOLERANCE else f"it moved by {row['max_u']:.2g}")


def _few_iterations(record: Record, row: Row) -> str:
    reason = converged(record, row)
    few = row["newton"] <= TRUST_LIMIT
    return reason or ("" if few else f"{row['newton']} Newton iterations")


def tables(rows: pd.DataFrame) -> str:
    """Return a line for each run."""
    lines = [
        [
            row["point"].removeprefix("loads-").partition("-nu")[0] + f", {row['cells']:g}^3"
            + (", continuation" if row["point"].endswith("continuation") else ""),
            f"{row['nu']:g}", row["element"], row["hessian"], row["globalization"],
            row["reason"] or row["status"],
            *(_number(row[key], ",.0f") for key in ("newton", "clamped", "linear")),
            _number(row["min_J"], ".3f"), _number(row["energy"], ".4g"),
            _number(100 * (row["volume_ratio"] - 1), "+.2f"),
            _number(row["nonfinite"], ".0f"), _number(row["seconds"], ".1f"),
        ]
        for row in rows.astype({"reason": object}).fillna({"reason": ""}).to_dict("records")
    ]  # fmt: skip
    head = [
        "load", "nu", "element", "Hessian", "globalization", "result", "Newton", "filtered",
        "linear", "min J", "energy", "volume [%]", "NaN seen", "seconds",
    ]  # fmt: skip
    return markdown_table(head, lines)


def _number(value: float, format: str) -> str:
    return "-" if value != value else f"{value:{format}}"


def pictures(out: Path) -> list[Picture]:
    """Return the stretched, compressed and twisted bodies at nu = 0.49."""

    def panels(labels: dict[str, str]) -> list[tuple[str, float, str]]:
        return [
            (f"loads-{name}-nu0.49-Q1-{CELLS}-adaptive", 1.0, label)
            for name, label in labels.items()
        ]

    stretched = panels({"stretch-3.4": "to 3.4", "stretch-10": "to 10"})
    compressed = panels({"compress-0.05": "to 5 %"})
    twisted = panels({"twist-half-pi": "π/2", "twist-pi": "π", "twist-4pi-in-8": "4π in eight"})
    return [
        body_picture(out, "stretched.png", stretched, "Stretched in one step, nu = 0.49."),
        body_picture(out, "compressed.png", compressed, "Compressed in one step, nu = 0.49."),
        body_picture(out, "twisted.png", twisted, "Twisted, nu = 0.49."),
    ]
