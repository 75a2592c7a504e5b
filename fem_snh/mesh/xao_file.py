"""XAO files: the exact shape of a body, as OpenCASCADE's BREP, and its groups.

gmsh (4.13 and later) and Salome write them. A file lists the vertices, edges, faces and solids of
its shape, each with its number in the order in which OpenCASCADE visits the shape (``TopExp``);
the elements of a group are places in these lists. gmsh 4.8 knows the BREP alone, and numbers what
it reads of each kind in the same order: the ranks of the numbers are what both have in common.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from fem_snh.errors import BadInput

#: What the lists and their entries are called, by dimension.
LISTS = ("vertices", "edges", "faces", "solids")
ENTRIES = ("vertex", "edge", "face", "solid")


class ShapeGroup(NamedTuple):
    """A group of a shape.

    Attributes
    ----------
    name : str
        Its name; empty without one.
    dim : int
        0 vertices, 1 edges, 2 faces, 3 solids.
    tag : int
        Its number; -1 without one.
    ranks : list of int
        Its elements, by their ranks among all entries of the dimension.
    """

    name: str
    dim: int
    tag: int
    ranks: list[int]


class ShapeFile(NamedTuple):
    """The content of a file.

    Attributes
    ----------
    brep : str
        The shape.
    counts : dict of str to int
        The number of vertices, edges, faces and solids, in this order.
    groups : list of ShapeGroup
        The groups with elements.
    """

    brep: str
    counts: dict[str, int]
    groups: list[ShapeGroup]


def read(path: Path) -> ShapeFile:
    """Return the content of a file. Raises BadInput and OSError."""
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
            groups.append(ShapeGroup(name, dim, tag, [ranks[dim][index] for index in elements]))
    counts = {kind: len(of_dim) for kind, of_dim in zip(LISTS, ranks, strict=True)}
    return ShapeFile(brep, counts, groups)


def _number(element: ET.Element, key: str) -> int:
    """Return a whole number, at least 0, that an element has as an attribute."""
    text = element.get(key, "")
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise BadInput(f"{element.tag}: {key} = '{text}': expected a whole number")
    return int(text)
