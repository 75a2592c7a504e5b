"""What pictures show of run.json: materials, the load or time of states, solids."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fem_snh.errors import bad_value
from fem_snh.geometry.rotations import exponential
from fem_snh.records.run_tables import column_unit
from fem_snh.records.units import Units

#: Keys of run.json whose solids are drawn.
KINDS = ("obstacles", "bones", "rigid")
#: Difference of two loads, or of times relative to the duration, that are the same.
_SAME = 1e-6


def materials(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the entries of a run's materials in run.json: one, or several with their groups."""
    found = record["material"]
    return found if isinstance(found, list) else [found]


def material_name(record: dict[str, Any]) -> str:
    """Return the names of the materials, each once."""
    return " + ".join(dict.fromkeys(pretty(str(m["name"])) for m in materials(record)))


def poisson_ratio(record: dict[str, Any]) -> str:
    """Return Poisson's ratio as text; several materials have each value once, in their order."""
    return ", ".join(dict.fromkeys(f"{m['nu']:g}" for m in materials(record)))


def pretty(name: str) -> str:
    """Return the name of a material for a label: "stable Neo-Hookean"."""
    return name.replace("neo_hookean", "Neo-Hookean").replace("_", " ")


def duration(record: dict[str, Any]) -> float | None:
    """Return the end of a run in time [s]; None for a quasi-static run."""
    return float(record["time"]["duration"]) if "time" in record else None


def load_range(record: dict[str, Any]) -> tuple[float, float]:
    """Return the values of the load parameter at load 0 and load 1; of a run in time, times [s]."""
    end = duration(record)
    low, high = record.get("load_range", (0.0, 1.0)) if end is None else (0.0, end)
    return float(low), float(high)


def load_name(record: dict[str, Any]) -> str:
    """Return what graphs call the load parameter."""
    return str(record.get("load_name", "load")) if duration(record) is None else "time"


def load_unit(record: dict[str, Any]) -> str:
    """Return the unit of the load parameter, after a space; none for a quasi-static run."""
    return "" if duration(record) is None else f" {unit_name('s', [record])}"


def common_units(records: Sequence[dict[str, Any]]) -> Units | None:
    """Return the units that the scenes of all runs state; None if one states none or others."""
    found = {Units.of(record) for record in records} or {None}
    return found.pop() if len(found) == 1 else None


def unit_name(unit: str, records: Sequence[dict[str, Any]]) -> str:
    """Return the name of an SI unit in the units of runs, which are SI units if none are stated."""
    return (common_units(records) or Units()).name(unit)


def column_label(name: str, records: Sequence[dict[str, Any]]) -> str:
    """Return a column's name, with its unit if the scenes state their units."""
    steps, units = [step for r in records for step in r["steps"]], common_units(records)
    unit = next(filter(None, (column_unit(name, step) for step in steps)), "") if units else ""
    return f"{name} [{units.name(unit)}]" if units and unit else name


def axis_label(record: dict[str, Any]) -> str:
    """Return the label of an axis of the load parameter."""
    return load_name(record) + (f" [{load_unit(record).strip()}]" if load_unit(record) else "")


def parameter(record: dict[str, Any], stored: float) -> float:
    """Return the load parameter of a stored state, whose .pvd file has the load, or the time."""
    low, high = load_range(record)
    return low + stored * (high - low) if duration(record) is None else stored


def step_at(record: dict[str, Any], stored: float) -> dict[str, Any] | None:
    """Return the last step that ends at a stored state."""
    key, scale = ("load", 1.0) if duration(record) is None else ("time", duration(record) or 1.0)
    found = [s for s in record["steps"] if math.isclose(s[key], stored, abs_tol=_SAME * scale)]
    return found[-1] if found else None


def check_hidden(record: dict[str, Any], names: Collection[str]) -> None:
    """Raise BadInput for a name that no solid and no group of cells of a run has."""
    groups = [name for part in record.get("cell_groups", []) for name in part]
    known = list(dict.fromkeys([n for kind in KINDS for n in record.get(kind, {})] + groups))
    for name in names:
        if name not in known:
            accepted = "a run with obstacles, bones, rigid shapes or several groups of cells"
            accepted = f"one of {', '.join(known)}" if known else accepted
            raise bad_value("--hide", name, accepted, known)


def hidden_cells(record: dict[str, Any], names: Collection[str]) -> tuple[int, ...]:
    """Return the values of the field ``cell_group`` in groups or materials of some names."""
    parts = record.get("cell_groups", [])
    return tuple(number for number, part in enumerate(parts) if not set(names).isdisjoint(part))


def obstacle_poses(
    record: dict[str, Any], folder: Path, at: float | None = None, hide: Collection[str] = ()
) -> list[dict[str, Any]]:
    """Return the solids of a run: kind, shape, and the pose at each load or time.

    With ``at`` these are two loads [or times in s], one of which is the closest to it. A surface is
    given by the path of its file in the folder. A bone that is a group of the mesh is left out, as
    are those whose names are in ``hide``.
    """
    found = []
    key = "load" if duration(record) is None else "time"
    steps = [step for step in record["steps"] if step.get("converged", True)]
    items = [(k, n, about) for k in KINDS for n, about in record.get(k, {}).items()]
    for kind, name, about in items:
        if "shape" not in about or name in hide:
            continue
        first = about.get("pose", np.eye(3, 4).tolist())
        poses = {0.0: first} | {step[key]: _pose(step[kind][name], about) for step in steps}
        if len(poses) == 1:
            poses[1.0] = first  # an interpolation needs two
        loads = sorted(poses)
        if at is not None:
            closest = min(range(len(loads)), key=lambda i: abs(loads[i] - at))
            nearest = min(closest, len(loads) - 2)
            loads = loads[nearest : nearest + 2]
        shape = dict(about["shape"])
        if "surface" in shape:
            shape["surface"] = str(folder / shape["surface"])
        at_loads = [poses[load] for load in loads]
        if record.get("kinematics") == "axisymmetric_torsion":  # it turns about its own axis
            at_loads = [
                [[*(float(i == j) for j in range(3)), pose[i][3]] for i in range(3)]
                for pose in at_loads
            ]
        found.append({"kind": kind, "shape": shape, "loads": loads, "poses": at_loads})
    return found


def _pose(state: dict[str, Any], about: dict[str, Any]) -> list[list[float]]:
    """Return the rows [R | c] of a solid in a state; of a rigid part from its point's position."""
    if "pose" in state:
        return list(state["pose"])
    R = exponential(np.array(state["rotation"]))
    c = np.array(state["position"]) - R @ np.array(about["point"])
    return [list(map(float, row)) for row in np.column_stack([R, c])]
