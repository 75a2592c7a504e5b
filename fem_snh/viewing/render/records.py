"""What pictures show of a run: materials, the load or time of states, solids, fields."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fem_snh.errors import BadInput, bad_value
from fem_snh.files import open_file
from fem_snh.geometry.rotations import exponential
from fem_snh.records.output_fields import NAMED, STANDARD, VECTOR, OutputField
from fem_snh.records.run_tables import column_unit
from fem_snh.records.units import Units

#: Keys of run.json whose solids are drawn.
KINDS = ("obstacles", "bones", "rigid")
#: Difference of two loads, or of times relative to the duration, that are the same.
_SAME = 1e-6
_KNOWN = STANDARD | NAMED
#: Arrays of VTK files that describe the mesh.
_MESH = ("Points", "connectivity", "offsets", "types")
#: The displacement of the drawn surface, also where the colours show its magnitude.
VECTORS = "displacement vector"
#: Labels that do not follow from label and unit.
_LABELS = {
    "displacement": "|u|  (displacement)",
    "mode": "|u| / max |u|  (displacement of a mode)",
}


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


def stored_loads(pvd: Path) -> dict[float, list[Path]]:
    """Return {load: .vtu files} of a collection (.pvd) that dolfinx's VTKFile wrote.

    The collection names .vtu files or .pvtu files, which name one .vtu per rank. dolfinx 0.5 lists
    each file once per field; duplicates are removed.
    """
    found: dict[float, list[Path]] = {}
    for data in _elements(pvd, "DataSet"):
        file = pvd.parent / data.get("file", "")
        pieces = [file]
        if file.suffix == ".pvtu":
            pieces = [file.parent / p.get("Source", "") for p in _elements(file, "Piece")]
        missing = [p for p in pieces if not p.is_file()]
        if missing:
            raise BadInput(f"{missing[0]}: missing, but {file.name} refers to it")
        found.setdefault(float(data.get("timestep", "nan")), []).extend(pieces)
    if not found:
        raise BadInput(f"{pvd}: holds no fields")
    return {load: list(dict.fromkeys(pieces)) for load, pieces in found.items()}


def _elements(path: Path, tag: str) -> list[ET.Element]:
    try:
        with open_file(path) as file:
            return list(ET.parse(file).iter(tag))
    except FileNotFoundError:
        raise BadInput(f"{path}: missing: the run has stored no fields") from None
    except (OSError, ET.ParseError) as error:
        raise BadInput(f"{path}: cannot be read: {one_line(error)}") from None


def split_component(field: str) -> tuple[str, str]:
    """Return name and component of ``cauchy_stress.xy``; component "" for a whole field."""
    name, _, component = field.partition(".")
    return name, component


def component_index(field: str) -> int | None:
    """Return the index of the component that ``field`` names, or None for a whole field."""
    name, component = split_component(field)
    return _components(name).index(component) if component else None


def label(field: str, units: Units | None = None) -> str:
    """Return the label of the colour bar of a field or component, with its unit.

    Without ``units`` it is that of SI, and a displacement has none.
    """
    if field == "displacement" and units:
        return f"{_LABELS[field]} [{units.length}]"
    if field in _LABELS:
        return _LABELS[field]
    name, component = split_component(field)
    known = _KNOWN.get(name, OutputField(name, ""))
    text = known.label
    if component:
        text = f"{text}, {component}"
    elif known.components:
        text = f"magnitude of the {text}"
    return f"{text} [{(units or Units()).name(known.unit)}]" if known.unit else text


def is_nonnegative(field: str) -> bool:
    """Return whether a field, or the magnitude that is drawn of it, cannot be negative."""
    name, component = split_component(field)
    known = _KNOWN.get(name, OutputField(name, ""))
    return known.nonnegative or bool(known.components and not component)


def check_field(pvd: Path, field: str) -> None:
    """Raise BadInput unless a run has written a field and the field has the component.

    Parameters
    ----------
    pvd : Path
        The collection of the run's states.
    field : str
        A name such as ``von_mises``, or a component such as ``cauchy_stress.xy``.
    """
    written = written_fields(pvd)
    name, component = split_component(field)
    if name not in written:
        accepted = f"one of {', '.join(written)}, which this run has written"
        if name in NAMED:
            accepted += f"; a run with --set fields={name} writes it"
        raise bad_value("field", field, accepted, written)
    components = _components(name)
    if component and component not in components:
        accepted = "a component of " + name if components else f"'{name}', a scalar"
        found = f": {', '.join(components)}" if components else ""
        raise bad_value("field", field, accepted + found)


def written_fields(pvd: Path) -> list[str]:
    """Return the names of the fields of a run's last state, sorted."""
    last = _elements(pvd, "DataSet")[-1].get("file", "")
    with open_file(pvd.parent / last) as opened:
        text = opened.read().partition(b"<AppendedData")[0].decode()
    names = set(re.findall(r'<P?DataArray [^>]*?Name="([^"]+)"', text))
    return sorted(name for name in names if name not in _MESH and not name.startswith("vtk"))


def _components(name: str) -> tuple[str, ...]:
    """Return the names of a field's components."""
    return _KNOWN[name].components if name in _KNOWN else VECTOR if name == "mode" else ()


def one_line(error: object) -> str:
    """Return the first line of an error's message."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]
