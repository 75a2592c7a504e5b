"""Errors of a study's rows, against the references that the same rows establish."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from fem_snh.studies.tradeoff.knobs import KNOBS
from fem_snh.studies.tradeoff.reference import (
    FREE,
    Reference,
    Vector,
    establish,
    estimate,
    norm,
    say,
)

_AXES = "xyz"
#: Below this part of the largest, a probe's displacement is none to be relative to.
_STILL = 1e-3


def quantities(groups: Sequence[str], probes: Sequence[str]) -> dict[str, list[str]]:
    """What errors are of: a name, and the columns of its components."""
    vectors = {"reaction": [f"reaction_{g}_{a}" for g in groups for a in _AXES]}
    vectors |= {f"displacement_{p}": [f"probe_{p}_{a}" for a in _AXES] for p in probes}
    return {"energy": ["energy"], "volume": ["volume_ratio"]} | {
        k: v for k, v in vectors.items() if v
    }


def columns(of: Mapping[str, Sequence[str]]) -> list[str]:
    """The columns of errors: of each quantity, of the displacement, and their floors."""
    names = [*of, *(["displacement"] if _probes(of) else [])]
    return [f"{kind}_{name}" for name in names for kind in ("error", "floor")] + ["shift"]


def _probes(of: Mapping[str, Sequence[str]]) -> list[str]:
    return [name for name in of if name.startswith("displacement_")]


def assess(
    table: pd.DataFrame, of: Mapping[str, Sequence[str]], say_so: Callable[[str], None]
) -> pd.DataFrame:
    """The table of one nu with its errors, relative to references made out of its default rows.

    ``error_Q`` is what was measured, ``floor_Q`` the smallest that the reference can tell: below
    it, all that is known is "at most the floor". A quantity whose reference is refused has neither.
    ``error_displacement`` and its floor are the largest of the probes', refused ones included;
    ``shift`` is how far the displacement is from that of the same element and mesh with default
    knobs.
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
        told = say(name, found, measured)
        say_so(told)
        refused = told.endswith("no errors")
        table[f"error_{name}"] = np.nan if refused else errors
        table[f"floor_{name}"] = np.nan if refused or found is None else found.floor
        if name in probes:
            floor = np.nan if found is None else found.floor
            largest["error"] = np.maximum(largest["error"], errors)
            largest["floor"] = np.maximum(largest["floor"], floor)
    if probes:
        told_any = np.nanmax(largest["error"], initial=0.0) > np.nanmax(
            largest["floor"], initial=0.0
        )
        for kind, values in largest.items():
            table[f"{kind}_displacement"] = values if told_any else np.nan
        table["shift"] = shifts(table[good], [c for name in probes for c in of[name]])
    return table


def reference(table: pd.DataFrame, values: Vector) -> Reference | None:
    """The reference of a quantity: (rows, n) values of a table of rows that converged.

    Candidates are the elements of FREE, each with its default knobs.
    """
    found = []
    for element in table["element"].unique():
        if element not in FREE:
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
    """How far each row's displacements are from its default's, relative to the default's."""
    moved = pd.Series(np.nan, index=table.index)
    resolution = table["cells"].astype(str) + table["mesh"].astype(str)
    for _, rows in table.groupby([table["element"], resolution]):
        default = rows[rows["default"].astype(str) == "True"]
        if len(default) == 1:
            base = default[list(components)].to_numpy(dtype=float)[0]
            all = rows[list(components)].to_numpy(dtype=float)
            moved[rows.index] = np.linalg.norm(all - base, axis=1) / norm(base)
    return moved


def told(row: Mapping[str, Any], name: str = "displacement") -> float:
    """What may be said of a row's error: at most this. NaN if nothing.

    What a turned knob changes of the answer is added: it may cancel a mesh's error, by chance.
    """
    error, floor = float(row[f"error_{name}"]), float(row[f"floor_{name}"])
    shift = float(row["shift"])
    return max(error + (shift if shift == shift else 0.0), floor)


def is_default(choice: Mapping[str, Any], default: Mapping[str, Any]) -> bool:
    """Whether every knob is where the default has it."""
    return all(choice[knob] == default[knob] for knob in KNOBS)
