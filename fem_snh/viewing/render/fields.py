"""Find the fields that a run has written, by name or by component, and their labels."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from fem_snh.errors import BadInput, bad_value
from fem_snh.files import open_file
from fem_snh.records.output_fields import NAMED, STANDARD, VECTOR, OutputField
from fem_snh.records.units import Units

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
    try:
        with open_file(pvd) as file:
            states = [data.get("file", "") for data in ET.parse(file).iter("DataSet")]
        content = open_file(pvd.parent / states[-1]).read() if states else b""
    except FileNotFoundError as error:
        raise BadInput(f"{error.filename}: missing: the run has stored no fields") from None
    except (OSError, ET.ParseError) as error:
        raise BadInput(f"{pvd}: cannot be read: {error}") from None
    text = content.partition(b"<AppendedData")[0].decode()
    names = set(re.findall(r'<P?DataArray [^>]*?Name="([^"]+)"', text))
    return sorted(name for name in names if name not in _MESH and not name.startswith("vtk"))


def _components(name: str) -> tuple[str, ...]:
    """Return the names of a field's components."""
    return _KNOWN[name].components if name in _KNOWN else VECTOR if name == "mode" else ()
