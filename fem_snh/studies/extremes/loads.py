"""Big loads in one step: stretch, compression, twist."""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.studies.extremes.cases import Case, Check, Record, Row, converged, run_of
from fem_snh.studies.extremes.figures import Picture, side_by_side
from fem_snh.studies.pages import markdown

title = "Big loads in one step"
about = """\
The paper's cylinder stretched, or pressed together, and its cube twisted, all at once. A turn by
2 pi in one step is the identity for the boundary: the body is at rest, and to be left so. 4 pi in
eight steps, each a quarter turn, is a body wound up twice."""

NUS = (0.3, 0.49, 0.4999)
#: Newton iterations that the twist by pi at nu = 0.3 may take with ``trust``.
TRUST = 40

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
    """Every load at every nu."""
    cells = 4 if quick else 8
    names = ("stretch-3.4", "twist-half-pi", "twist-2pi") if quick else tuple(_LOADS)
    made = [_case(name, nu, cells) for name in names for nu in NUS]
    made.append(_case("twist-pi", 0.3, cells, "trust"))
    return made


def _case(name: str, nu: float, cells: int, hessian: str = "adaptive") -> Case:
    scene, values = _LOADS[name]
    check: Check = _unmoved if name == "twist-2pi" else converged
    asked = "left at rest" if name == "twist-2pi" else "reaches its load"
    if hessian == "trust":
        check, asked = _few, f"reaches its load in at most {TRUST} Newton steps"
    full = {"steps": 1, **values}
    full |= {"cells": cells, "nu": nu, "hessian": hessian}
    return run_of(scene, f"loads-{name}-nu{nu:g}-{hessian}", asked, check, **full)


def _unmoved(record: Record, row: Row) -> str:
    why = converged(record, row)
    return why or ("" if row["max_u"] < 1e-6 else f"it moved by {row['max_u']:.2g}")


def _few(record: Record, row: Row) -> str:
    why = converged(record, row)
    return why or ("" if row["newton"] <= TRUST else f"{row['newton']} Newton steps")


def tables(rows: pd.DataFrame) -> str:
    """A line for each run."""
    lines = [
        [
            row["point"].removeprefix("loads-").partition("-nu")[0],
            f"{row['nu']:g}", row["hessian"], row["status"],
            *(_number(row[key], ",.0f") for key in ("newton", "clamped", "linear")),
            _number(row["min_J"], ".3f"),
            _number(100 * (row["volume_ratio"] - 1), "+.2f"),
            _number(row["nonfinite"], ".0f"), _number(row["seconds"], ".1f"),
        ]
        for row in rows.to_dict("records")
    ]  # fmt: skip
    head = ["load", "nu", "Hessian", "status", "Newton", "filtered", "linear", "min J"]
    return markdown([*head, "volume [%]", "NaN seen", "seconds"], lines)


def _number(value: float, format: str) -> str:
    return "-" if value != value else f"{value:{format}}"


def pictures(out: Path) -> list[Picture]:
    """Stretched, pressed, twisted; all at nu = 0.49."""

    def names(loads: list[str]) -> list[str]:
        return [f"loads-{load}-nu0.49-adaptive" for load in loads]

    pulled, turned = ["stretch-3.4", "stretch-10"], ["twist-half-pi", "twist-pi", "twist-4pi-in-8"]
    caption = "Each in one step, nu = 0.49."
    return [
        side_by_side(out, "stretched.png", names(pulled), ["3.4", "10"], 1.0, caption),
        side_by_side(out, "compressed.png", names(["compress-0.05"]), ["5 %"], 1.0, caption),
        side_by_side(
            out, "twisted.png", names(turned), ["π/2", "π", "4π in eight"], 1.0, "nu = 0.49."
        ),
    ]
