"""Compute the errors of the rows of a study, relative to references made from the same rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from fem_snh.studies.tradeoff.reference import (
    LOCKING_FREE,
    MARGIN,
    ReferenceValue,
    Vector,
    establish,
    estimate,
    norm,
    reference_message,
)

_AXES = "xyz"


def quantities(groups: Sequence[str], probes: Sequence[str]) -> dict[str, list[str]]:
    """Return the quantities that have errors: {name: columns of its components}."""
    vectors = {"reaction": [f"{g}.force.{a}" for g in groups for a in _AXES]}
    vectors |= {f"displacement_{p}": [f"{p}.{a}" for a in _AXES] for p in probes}
    return {"energy": ["energy"], "volume": ["volume_ratio"]} | {
        k: v for k, v in vectors.items() if v
    }


def columns(of: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the names of the error columns of each quantity and of the displacement."""
    names = [*of, *(["displacement"] if _probes(of) else [])]
    return [f"{kind}_{name}" for name in names for kind in ("error", "floor")] + ["shift"]


def _probes(of: Mapping[str, Sequence[str]]) -> list[str]:
    return [name for name in of if name.startswith("displacement_")]


def assess(
    table: pd.DataFrame, of: Mapping[str, Sequence[str]], report: Callable[[str], None]
) -> pd.DataFrame:
    """Return the table of one nu with its errors, relative to references from its default rows.

    ``error_Q`` is the measured error and ``floor_Q`` the smallest error that the reference can
    resolve: an error below it is known to be at most the floor. A quantity whose reference is
    rejected has neither. ``error_displacement`` and its floor are the largest of all probes,
    rejected ones included. ``shift`` is the relative difference of the displacement to that of the
    same element and mesh with default settings.
    """
    table = table.copy()
    probes = _probes(of)
    largest: dict[str, np.ndarray] = {kind: np.zeros(len(table)) for kind in ("error", "floor")}
    good = table["converged"].astype(str) == "True"
    for name, components in of.items():
        values = table[list(components)].to_numpy(dtype=float)
        found = reference(table[good], values[good.to_numpy()])
        errors: np.ndarray = np.full(len(table), np.nan)
        if found is not None:
            errors = np.array([found.error_of(value) for value in values])
            errors[~good.to_numpy()] = np.nan
        measured = {point: e for point, e in zip(table["point"], errors, strict=True) if e == e}
        message = reference_message(name, found, measured)
        report(message)
        rejected = message.endswith("no errors")
        table[f"error_{name}"] = np.nan if rejected else errors
        table[f"floor_{name}"] = np.nan if rejected or found is None else found.floor
        if name in probes:
            floor = np.nan if found is None else found.floor
            largest["error"] = np.maximum(largest["error"], errors)
            largest["floor"] = np.maximum(largest["floor"], floor)
    if probes:
        resolved = np.nanmax(largest["error"], initial=0.0) > np.nanmax(
            largest["floor"], initial=0.0
        )
        for kind, values in largest.items():
            table[f"{kind}_displacement"] = values if resolved else np.nan
        table["shift"] = shifts(table[good], [c for name in probes for c in of[name]])
    return table


def reference(table: pd.DataFrame, values: Vector) -> ReferenceValue | None:
    """Return the reference of a quantity from its values (rows, n) in converged rows.

    Candidates are the elements of LOCKING_FREE, each with its default settings.
    """
    found = []
    for element in table["element"].unique():
        if element not in LOCKING_FREE:
            continue
        mine = ((table["element"] == element) & (table["default"].astype(str) == "True")).to_numpy()
        rows = table[mine].assign(at=np.flatnonzero(mine)).sort_values("h", ascending=False)
        if len(rows) < 3:
            continue
        finest = rows.iloc[-1]
        where = (
            f"{finest['cells']:g} cells" if finest["cells"] == finest["cells"] else finest["mesh"]
        )
        one = estimate(element, where, rows["h"].tolist(), list(values[rows["at"]]))
        if one is not None:
            found.append(one)
    return establish(found)


def shifts(table: pd.DataFrame, components: Sequence[str]) -> pd.Series:
    """Return the relative difference of each row's displacements to those of its default row."""
    moved = pd.Series(np.nan, index=table.index)
    resolution = table["cells"].astype(str) + table["mesh"].astype(str)
    for _, rows in table.groupby([table["element"], resolution]):
        default = rows[rows["default"].astype(str) == "True"]
        if len(default) == 1:
            base = default[list(components)].to_numpy(dtype=float)[0]
            all = rows[list(components)].to_numpy(dtype=float)
            moved[rows.index] = np.linalg.norm(all - base, axis=1) / norm(base)
    return moved


def error_bound(row: Mapping[str, Any]) -> float:
    """Return an upper bound of the error of a row's displacement; NaN if it is unknown.

    It contains the shift by a changed setting, which could cancel the error of the mesh by chance,
    and the reference's own error r = floor / MARGIN: a value that differs by e from a reference
    which differs by r from the solution has an error of at most (e + r) / (1 - r).
    """
    error, floor = float(row["error_displacement"]), float(row["floor_displacement"])
    shift, own = float(row["shift"]), floor / MARGIN
    if own >= 1:
        return float("inf")
    return max((error + (shift if shift == shift else 0.0) + own) / (1 - own), floor)
