"""Read a run's folder for pictures, pages and exports: states, fields, solids, labels, views."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from fem_snh.errors import BadInput, bad_value
from fem_snh.geometry.rotations import exponential
from fem_snh.records.output_fields import NAMED, STANDARD, VECTOR, OutputField
from fem_snh.records.run_record import Record, column_unit, load_record
from fem_snh.records.units import Units, volume_change

#: Keys of run.json whose solids are drawn.
KINDS = ("obstacles", "bones", "rigid")
#: Two loads are the same up to this difference; times, relative to the duration.
_SAME = 1e-6
#: Separator of the parts of a label.
DOT = "  ·  "
#: Arrays of VTK files that describe the mesh.
_MESH = ("Points", "connectivity", "offsets", "types")
#: The surface's displacement as vectors; colouring by "displacement" replaces it by magnitudes.
VECTORS = "displacement vector"
#: Colour-bar labels that are not made from the field's label and unit.
_LABELS = {
    "displacement": "|u|  (displacement)",
    "mode": "|u| / max |u|  (displacement of a mode)",
}


def materials(record: Record) -> list[dict[str, Any]]:
    """Return the entries of a run's materials in run.json: one, or several with their groups."""
    found = record["material"]
    return found if isinstance(found, list) else [found]


def material_name(record: Record) -> str:
    """Return the names of the materials, joined by " + ", each once."""
    return " + ".join(dict.fromkeys(pretty(str(m["name"])) for m in materials(record)))


def poisson_ratio(record: Record) -> str:
    """Return the Poisson's ratios of the materials as text, each value once, in their order."""
    return ", ".join(dict.fromkeys(f"{m['nu']:g}" for m in materials(record)))


def pretty(name: str) -> str:
    """Return the label of a material's name: "stable Neo-Hookean" for "stable_neo_hookean"."""
    return name.replace("neo_hookean", "Neo-Hookean").replace("_", " ")


def duration(record: Record) -> float | None:
    """Return the end time of a dynamic run [s], or None for a quasi-static run."""
    return float(record["time"]["duration"]) if "time" in record else None


def load_range(record: Record) -> tuple[float, float]:
    """Return the load parameter at load 0 and at load 1; (0, end time [s]) of a dynamic run."""
    end = duration(record)
    low, high = record.get("load_range", (0.0, 1.0)) if end is None else (0.0, end)
    return float(low), float(high)


def load_name(record: Record) -> str:
    """Return the name of the load parameter for labels: the scene's, "load" or "time"."""
    return str(record.get("load_name", "load")) if duration(record) is None else "time"


def load_unit(record: Record) -> str:
    """Return the unit of time after a space, " s"; "" for a quasi-static run."""
    return "" if duration(record) is None else f" {unit_name('s', [record])}"


def common_units(records: Sequence[Record]) -> Units | None:
    """Return the units that the scenes of all runs state; None if one states none or two differ."""
    found = {Units.of(record) for record in records} or {None}
    return found.pop() if len(found) == 1 else None


def unit_name(unit: str, records: Sequence[Record]) -> str:
    """Return the name of an SI unit in the common units of runs; unchanged if they have none."""
    return (common_units(records) or Units()).name(unit)


def column_label(name: str, records: Sequence[Record]) -> str:
    """Return a column's name, followed by its unit if the runs have common units."""
    steps, units = [step for r in records for step in r["steps"]], common_units(records)
    unit = next(filter(None, (column_unit(name, step) for step in steps)), "") if units else ""
    return f"{name} [{units.name(unit)}]" if units and unit else name


def axis_label(record: Record) -> str:
    """Return the axis label of the load parameter, such as "load" or "time [s]"."""
    return load_name(record) + (f" [{load_unit(record).strip()}]" if load_unit(record) else "")


def parameter(record: Record, stored: float) -> float:
    """Return the load parameter at a stored load, or a stored time [s] unchanged."""
    low, high = load_range(record)
    return low + stored * (high - low) if duration(record) is None else stored


def step_at(record: Record, stored: float) -> dict[str, Any] | None:
    """Return the last step in run.json that ends at a stored load or time, or None."""
    key, scale = ("load", 1.0) if duration(record) is None else ("time", duration(record) or 1.0)
    found = [s for s in record["steps"] if math.isclose(s[key], stored, abs_tol=_SAME * scale)]
    return found[-1] if found else None


def hidden_cells(record: Record, names: Collection[str]) -> tuple[int, ...]:
    """Return the values of the field ``cell_group`` in the named groups of cells and materials.

    Raises
    ------
    BadInput
        For a name that no solid, group of cells or material of the run has.
    """
    parts = record.get("cell_groups", [])
    solids = [name for kind in KINDS for name in record.get(kind, {})]
    known = list(dict.fromkeys([*solids, *(name for part in parts for name in part)]))
    for name in names:
        if name not in known:
            accepted = "a run with obstacles, bones, rigid shapes or several groups of cells"
            accepted = f"one of {', '.join(known)}" if known else accepted
            raise bad_value("--hide", name, accepted, known)
    return tuple(number for number, part in enumerate(parts) if not set(names).isdisjoint(part))


def obstacle_poses(
    record: Record, folder: Path, hide: Collection[str] = ()
) -> list[dict[str, Any]]:
    """Return the drawn solids of a run: dictionaries of kind, shape, loads (m) and poses (m, 3, 4).

    The poses are [R | c], or [A | c] of bones, at load (or time) 0 and after the converged steps. A
    surface is given by the path of its file in ``folder``. Bones that are groups of the mesh and
    solids named in ``hide`` are omitted.
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
        shape = dict(about["shape"])
        if "surface" in shape:
            shape["surface"] = str(folder / shape["surface"])
        at_loads = np.array([poses[load] for load in loads], dtype=float)
        if record.get("kinematics") == "axisymmetric_torsion":  # it turns about its own axis
            at_loads[:, :, :3] = np.eye(3)
        found.append({"kind": kind, "shape": shape, "loads": loads, "poses": at_loads.tolist()})
    return found


def _pose(state: dict[str, Any], about: dict[str, Any]) -> list[list[float]]:
    """Return the rows [R | c] of a solid from its entries in a step and in run.json (``about``)."""
    if "pose" in state:
        return list(state["pose"])
    R = exponential(np.array(state["rotation"]))
    c = np.array(state["position"]) - R @ np.array(about["point"])
    return [list(map(float, row)) for row in np.column_stack([R, c])]


def stored_loads(pvd: Path) -> dict[float, list[Path]]:
    """Return {load or time: .vtu files} of a collection (.pvd) that dolfinx's VTKFile wrote.

    The collection names .vtu files, or .pvtu files that name one .vtu per rank. dolfinx 0.5 lists
    each file once per field; duplicates are removed. BadInput if a file is missing or damaged.
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
        return list(ET.parse(path).iter(tag))
    except FileNotFoundError:
        raise BadInput(f"{path}: missing: the run has stored no fields") from None
    except (OSError, ET.ParseError) as error:
        raise BadInput(f"{path}: cannot be read: {one_line(error)}") from None


def split_component(field: str) -> tuple[str, str]:
    """Return name and component of a field such as ``cauchy_stress.xy``; "" for a whole field."""
    name, _, component = field.partition(".")
    return name, component


def component_index(field: str) -> int | None:
    """Return the index of the component that ``field`` names, or None for a whole field."""
    name, component = split_component(field)
    return _about(name).components.index(component) if component else None


def label(field: str, units: Units | None = None) -> str:
    """Return the label of the colour bar of a field or component, with its unit.

    Without ``units``, the unit is the SI unit; the label of a displacement then has no unit.
    """
    if field in _LABELS:
        unit = f" [{units.length}]" if units and field == "displacement" else ""
        return _LABELS[field] + unit
    name, component = split_component(field)
    about = _about(name)
    text = f"{about.label}, {component}" if component else about.label
    if about.components and not component:
        text = f"magnitude of the {text}"
    return f"{text} [{(units or Units()).name(about.unit)}]" if about.unit else text


def is_nonnegative(field: str) -> bool:
    """Return whether a field, or the magnitude drawn of a vector or tensor, is never negative."""
    name, component = split_component(field)
    about = _about(name)
    return about.nonnegative or bool(about.components and not component)


def _about(name: str) -> OutputField:
    """Return the description of a field; an unknown field is a scalar without a unit."""
    other = OutputField(name, "", VECTOR if name == "mode" else ())
    return STANDARD.get(name) or NAMED.get(name) or other


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
    components = _about(name).components
    if component and component not in components:
        accepted = f"a component of {name}: {', '.join(components)}"
        raise bad_value("field", field, accepted if components else f"'{name}', a scalar")


def written_fields(pvd: Path) -> list[str]:
    """Return the sorted names of the fields in the last file of a collection (.pvd)."""
    last = _elements(pvd, "DataSet")[-1].get("file", "")
    text = (pvd.parent / last).read_bytes().partition(b"<AppendedData")[0].decode()
    names = set(re.findall(r'<P?DataArray [^>]*?Name="([^"]+)"', text))
    return sorted(name for name in names if name not in _MESH and not name.startswith("vtk"))


def one_line(error: object) -> str:
    """Return the first line of an error's message."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


Point = tuple[float, float, float]
#: Direction from the body to the viewer, unless the user chooses one or the body is long or flat.
TOWARDS = (0.62, -1.0, 0.55)


@dataclass(frozen=True)
class ViewOptions:
    """What is shown, and from which direction.

    Attributes
    ----------
    clip : (3,), optional
        Normal of a clip plane; the part of the deformed body on the side of the normal is cut away,
        and the section has the colours of the field.
    clip_point : (3,), optional
        A point of the plane [m]; default: the centre of the body at rest.
    camera : (3,), optional
        Direction from the body to the viewer.
    focus : (3,), optional
        The point at the centre of the picture [m].
    zoom : float
        Magnification: 1 shows the whole body.
    hide : tuple of str
        Names of obstacles, bones, groups of cells and materials that are not drawn.
    hidden_cells : tuple of int
        Values of the field ``cell_group`` in cells that are not drawn.
    limits : (2,), optional
        The values at the ends of the colour bar; default: see
        `fem_snh.viewing.render.drawing.colours`.
    """

    clip: Point | None = None
    clip_point: Point | None = None
    camera: Point | None = None
    focus: Point | None = None
    zoom: float = 1.0
    hide: tuple[str, ...] = ()
    hidden_cells: tuple[int, ...] = ()
    limits: tuple[float, float] | None = None


#: The whole body from the default side.
WHOLE = ViewOptions()


def view_options(
    clip: str | None = None,
    camera: str | None = None,
    zoom: float = 1.0,
    hide: Iterable[str] = (),
    limits: str | None = None,
) -> ViewOptions:
    """Return the view that the options of a command line describe.

    Parameters
    ----------
    clip : str, optional
        Normal and, after "@", a point of a plane: ``x``, ``-y``, ``0,0,1@0,0,0.2``. A number
        after "@" is the plane's distance from the origin along the normal.
    camera : str, optional
        Direction and, after "@", the focus: ``x``, ``1,-1,0.5@0,0,1``.
    zoom : float
        Magnification.
    hide : iterable of str
        Names of obstacles, bones, groups of cells and materials.
    limits : str, optional
        The values at the ends of the colour bar, ``0,2.5``.

    Raises
    ------
    BadInput
        If a text is no direction, point or range, or ``zoom`` is not positive.
    """
    if not 0 < zoom < math.inf:
        raise bad_value("--zoom", zoom, "a number above 0")
    normal, point = _direction_and_point("--clip", clip)
    towards, focus = _direction_and_point("--camera", camera)
    low, high = 0.0, 1.0
    if limits is not None:
        low, high = (*_numbers(limits), math.nan, math.nan)[:2]
        if not -math.inf < low < high < math.inf or limits.count(",") != 1:
            raise bad_value("--range", limits, "two numbers, the smaller one first: 0,2.5")
    ends = None if limits is None else (low, high)
    return ViewOptions(normal, point, towards, focus, zoom, tuple(hide), limits=ends)


def _direction_and_point(option: str, text: str | None) -> tuple[Point | None, Point | None]:
    """Return the unit vector and the point of ``0,0,1@0,0,0.2``; None for a missing one.

    A single number after "@" is a distance along the direction. BadInput for another text.
    """
    if text is None:
        return None, None
    before, at, after = text.partition("@")
    name = before.strip()
    direction, point = np.array(_numbers(before)), np.array(_numbers(after))
    if name.removeprefix("-") in VECTOR:
        direction = np.eye(3)[VECTOR.index(name[-1])] * (-1 if name[0] == "-" else 1)
    length = np.linalg.norm(direction)
    if len(direction) == 3 and 0 < length < math.inf and np.isfinite(point).all():
        unit = direction / length
        place = point * unit if len(point) == 1 else point
        if not at or len(place) == 3:
            return _point(unit), _point(place) if at else None
    accepted = "a direction, x, -y or 0,0,1, and perhaps a point of it: x@0.2 or 0,0,1@0,0,0.2"
    raise bad_value(option, text, accepted)


def _point(x: np.ndarray) -> Point:
    return float(x[0]), float(x[1]), float(x[2])


def _numbers(text: str) -> list[float]:
    """Return the numbers of a comma-separated list; none if an entry is not a number."""
    try:
        return [float(entry) for entry in text.split(",")]
    except ValueError:
        return []


@dataclass(frozen=True)
class Panel:
    """One panel: the files of a state (one per rank), label, load or time, and `obstacle_poses`."""

    files: list[Path]
    label: str
    load: float = 0.0
    obstacles: Sequence[dict[str, Any]] = ()


class StoredRun:
    """The folder of a run.

    Parameters
    ----------
    folder : Path
        The folder.
    field : str, optional
        A field, or a component of one, that the run must have written.
    view : ViewOptions, optional
        What is shown.

    Attributes
    ----------
    record : dict
        The content of run.json.
    view : ViewOptions
        The view, with the numbers of the hidden cells.
    pvd : Path
        The collection of the states: skin.pvd if a lattice carries a skin, else fields.pvd.
    states : dict
        {load or time: .vtu files of a stored state}, ascending.

    Raises
    ------
    BadInput
        If a file is missing or cannot be read, or the run has not written the field or has no
        part of a name that is to be hidden.
    """

    def __init__(
        self, folder: Path, field: str | None = None, view: ViewOptions | None = None
    ) -> None:
        folder, view = Path(folder), view or WHOLE
        self.record = read_record(folder)
        self.view = replace(view, hidden_cells=hidden_cells(self.record, view.hide))
        self._solids = obstacle_poses(self.record, folder, view.hide)
        skin = folder / "skin.pvd"
        self.pvd = skin if skin.is_file() else folder / "fields.pvd"
        self.states = dict(sorted(stored_loads(self.pvd).items()))
        if field is not None:
            check_field(self.pvd, field)

    def panel(self, load: float) -> Panel:
        """Return the panel of a stored load or time."""
        return Panel(self.states[load], panel_label(self.record, load), load, self._solids)


def read_record(folder: Path) -> Record:
    """Return ``folder/run.json``; raise BadInput if it is missing or no record of a run."""
    path = folder / "run.json"
    if not path.exists():
        raise BadInput(f"{folder}: no run.json here: give the folder of a run (--out DIR)")
    return load_record(path)


def choose_loads(stored: list[float], wanted: Sequence[float] | None) -> list[float]:
    """Return the stored loads to draw; raise BadInput if a wanted one was not stored.

    Default: the loads above 0 if there are at most four, else three at about 1/3, 2/3 and the end.
    """
    if wanted:
        same = 1e-6 * max(map(abs, stored))
        for load in wanted:
            if not any(math.isclose(load, s, abs_tol=same) for s in stored):
                raise BadInput(
                    f"no fields at load {load:g}: stored are {', '.join(f'{s:g}' for s in stored)}"
                )
        return [min(stored, key=lambda s: abs(s - load)) for load in wanted]
    steps = [s for s in stored if s > 0] or stored
    if len(steps) <= 4:
        return steps
    return [steps[round(i * len(steps) / 3) - 1] for i in (1, 2, 3)]


def title(record: Record) -> str:
    """Return scene, material, nu, element and number of cells in one line."""
    ratio = f"ν = {poisson_ratio(record)}"
    parts = [str(record["scene"]), material_name(record), ratio]
    if "cells" in record and "element" in record:
        parts.append(f"{record['cells']:,} {record['element']} cells".replace(",", "\u2009"))
    return DOT.join(parts)


def panel_label(record: Record, load: float) -> str:
    """Return the label of a stored state: load or time, volume change and smallest J of its step.

    A step that has not converged is marked.
    """
    value, unit = parameter(record, load), load_unit(record)
    label = f"{load_name(record)} {f'{value:.3g}' if unit else number_text(value)}{unit}"
    step = step_at(record, load) or {}
    if step.get("volume_ratio") is not None:
        label += f"{DOT}volume {volume_change(step['volume_ratio'])} %".replace("-", "\u2212")
    if step.get("min_J") is not None:
        label += f"{DOT}min J {step['min_J']:.2f}".replace("-", "\u2212")
    return label if step.get("converged", True) else f"{label}{DOT}not converged"


def number_text(x: float) -> str:
    """Return ``x`` as a fraction of pi with a denominator up to 12, "π/3", or with three digits."""
    turn = Fraction(x / math.pi).limit_denominator(12)
    if turn == 0 or not math.isclose(x, turn * math.pi, rel_tol=1e-9):
        return f"{x:.3g}"
    top = {1: "π", -1: "-π"}.get(turn.numerator, f"{turn.numerator}π")
    return top if turn.denominator == 1 else f"{top}/{turn.denominator}"
