"""Big loads in one step: stretch, compression, twist."""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.studies.extremes.cases import Case, Check, Record, Row, converged, run_of
from fem_snh.studies.extremes.pictures import Picture, bodies
from fem_snh.studies.markdown import markdown

title = "Big loads in one step"
about = """\
The paper's cylinder stretched, or pressed together, and its cube twisted, all at once. A turn by
2 pi in one step is the identity for the boundary: the body is at rest, and to be left so. 4 pi in
eight steps, each a quarter turn, may end in either of two states: wound up twice, or, as a rotation
by 4 pi can be undone without turning the ends back, at rest. A step that had to be halved does not
hold. Where a body has several equilibria, which one is found depends on the way: compare energies.

At nu = 0.4999 the element is Q1P0 and the steps begin with nu = 0.49 (`nu_continuation = [0.49]`).
Q1 locks there, which is not only wrong (docs/results/elements.md) but full of states in which a
descent gets stuck. It is there to be compared, as are plain steps of Q1P0, and `trust`."""

NUS = (0.3, 0.49, 0.4999)
#: From here on Q1 locks, and hardly finds its equilibrium; Q1P0 does not.
LOCKS = 0.4999
#: And from here on steps begin with this ratio.
SOFTER = [0.49]
CELLS = 6
#: Newton iterations that the twist by pi may take with ``trust``; for which nu, and cells.
TRUST = 40
CRAWLS = (0.3, 0.49)
FINER = (8, 10, 12, 15)

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
    """Every load at every nu, and what is there to be compared."""
    if quick:
        quickest = ("stretch-3.4", "twist-half-pi", "twist-2pi")
        return [_case(name, nu, 4) for name in quickest for nu in (0.3, 0.49)]
    made = [_case(name, nu, CELLS) for name in _LOADS for nu in NUS]
    made += [_case("twist-pi", nu, n, hessian="trust") for nu in CRAWLS for n in FINER]
    plain = [
        _case(name, LOCKS, CELLS, element=element, nu_continuation=[], must=False)
        for element in ("Q1P0", "Q1")
        for name in _LOADS
    ]
    trust = [_case(name, nu, CELLS, hessian="trust", must=False) for name in _LOADS for nu in NUS]
    return made + plain + trust


def _case(
    name: str,
    nu: float,
    cells: int,
    *,
    element: str = "",
    hessian: str = "adaptive",
    nu_continuation: list[float] | None = None,
    must: bool = True,
) -> Case:
    scene, values = _LOADS[name]
    element = element or ("Q1P0" if nu >= LOCKS else "Q1")
    if nu_continuation is None:
        nu_continuation = SOFTER if nu >= LOCKS else []
    check: Check = _unmoved if name == "twist-2pi" else converged
    asked = "left at rest" if name == "twist-2pi" else "reaches its load"
    if must and hessian == "trust":
        check, asked = _few, f"reaches its load in at most {TRUST} Newton steps"
    full = {"steps": 1, **values, "predictor": "none", "petsc.snes_max_it": 1000}
    full |= {"cells": cells, "nu": nu, "element": element, "hessian": hessian}
    full |= {"nu_continuation": nu_continuation}
    point = f"loads-{name}-nu{nu:g}-{element}-{cells}-{hessian}"
    point += "-softened" if nu_continuation else ""
    return run_of(scene, point, asked, check, must=must, **full)


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
            row["point"].removeprefix("loads-").partition("-nu")[0] + f", {row['cells']:g}^3"
            + (", softened" if row["point"].endswith("softened") else ""),
            f"{row['nu']:g}", row["element"], row["hessian"], row["why"] or row["status"],
            *(_number(row[key], ",.0f") for key in ("newton", "clamped", "linear")),
            _number(row["min_J"], ".3f"), _number(row["energy"], ".4g"),
            _number(100 * (row["volume_ratio"] - 1), "+.2f"),
            _number(row["nonfinite"], ".0f"), _number(row["seconds"], ".1f"),
        ]
        for row in rows.astype({"why": object}).fillna({"why": ""}).to_dict("records")
    ]  # fmt: skip
    head = [
        "load",
        "nu",
        "element",
        "Hessian",
        "",
        "Newton",
        "filtered",
        "linear",
        "min J",
        "energy",
    ]
    return markdown([*head, "volume [%]", "NaN seen", "seconds"], lines)


def _number(value: float, format: str) -> str:
    return "-" if value != value else f"{value:{format}}"


def pictures(out: Path) -> list[Picture]:
    """Stretched, pressed, twisted; all at nu = 0.49."""

    def panels(labels: dict[str, str]) -> list[tuple[str, float, str]]:
        return [
            (f"loads-{name}-nu0.49-Q1-{CELLS}-adaptive", 1.0, label)
            for name, label in labels.items()
        ]

    pulled = panels({"stretch-3.4": "to 3.4", "stretch-10": "to 10"})
    pressed = panels({"compress-0.05": "to 5 %"})
    turned = panels({"twist-half-pi": "π/2", "twist-pi": "π", "twist-4pi-in-8": "4π in eight"})
    return [
        bodies(out, "stretched.png", pulled, "Stretched in one step, nu = 0.49."),
        bodies(out, "compressed.png", pressed, "Pressed together in one step, nu = 0.49."),
        bodies(out, "twisted.png", turned, "Twisted, nu = 0.49."),
    ]
