"""XAO files: the exact shape of a body, as OpenCASCADE's BREP, and its groups.

gmsh (4.13 and later) and Salome write them. A file lists the vertices, edges, faces and solids of
its shape, each with its number in the order in which OpenCASCADE visits the shape (``TopExp``).
The elements of a group are positions in these lists. gmsh 4.8, of Debian 12, reads the BREP alone,
and numbers the entities of each kind in the same order: only the ranks of both numbers agree.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.mesh.gmsh_model import PhysicalGroup

#: XML names of the lists and of their entries, by dimension.
LISTS = ("vertices", "edges", "faces", "solids")
ENTRIES = ("vertex", "edge", "face", "solid")


def read(path: Path) -> tuple[str, list[int], list[PhysicalGroup]]:
    """Return the content of a file. Raises BadInput and OSError.

    Returns
    -------
    brep : str
        The shape in the BREP format.
    counts : list of int
        The number of vertices, edges, faces and solids.
    groups : list of PhysicalGroup
        The groups that are not empty. Their entities are ranks among all entries of the dimension.
        A missing name is "", a missing tag -1.
    """
    try:
        root = ET.fromstring(path.read_bytes())
    except ET.ParseError as error:
        raise BadInput(f"this is not an XAO file: {error}") from None
    shape, topology = root.find("geometry/shape"), root.find("geometry/topology")
    if root.tag != "XAO" or shape is None or topology is None:
        raise BadInput("this is not an XAO file: expected a shape and its topology")
    brep = (shape.text or "").strip()
    if shape.get("format") != "BREP" or "file" in shape.attrib or not brep:
        raise BadInput("its shape: expected a BREP in the file")
    ranks = []
    for dim, (entries, entry) in enumerate(zip(LISTS, ENTRIES, strict=True)):
        rows = topology.findall(f"{entries}/{entry}")
        numbers = {_number(row, "index"): _number(row, "reference") for row in rows}
        order = {number: rank for rank, number in enumerate(sorted(numbers.values()))}
        if len(order) != len(rows):
            raise BadInput(f"its {LISTS[dim]}: expected different numbers")
        ranks.append({index: order[number] for index, number in numbers.items()})
    groups = []
    for group in root.findall("groups/group"):
        kind, name = group.get("dimension"), group.get("name") or ""
        if kind not in ENTRIES:
            raise BadInput(f"its group '{name}': expected one of {', '.join(ENTRIES)}, not {kind}")
        dim = ENTRIES.index(kind)
        elements = [_number(element, "index") for element in group.findall("element")]
        if unknown := [index for index in elements if index not in ranks[dim]]:
            raise BadInput(f"its group '{name}': it has no {kind} {unknown[0]}")
        tag = _number(group, "tag") if "tag" in group.attrib else -1
        if elements:
            chosen = np.array([ranks[dim][index] for index in elements])
            groups.append(PhysicalGroup(name, dim, tag, chosen))
    return brep, [*map(len, ranks)], groups


def _number(element: ET.Element, key: str) -> int:
    """Return an element's attribute ``key``, a whole number >= 0; raise BadInput otherwise."""
    text = element.get(key, "")
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise BadInput(f"{element.tag}: {key} = '{text}': expected a whole number")
    return int(text)
