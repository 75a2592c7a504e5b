"""XAO files: the exact shape of a body, as OpenCASCADE's BREP, and its groups.

gmsh (4.13 and later) and Salome write them. A file lists the vertices, edges, faces and solids of
its shape, each with its number in the order in which OpenCASCADE visits the shape (``TopExp``);
the elements of a group are places in these lists. gmsh 4.8 knows the BREP alone, and numbers what
it reads of each kind in the same order: the ranks of the numbers are what both have in common.

`write_xao` is for a gmsh that cannot: up to 4.12, as of Debian 12. It writes the BREP, and reads it
again as a copy, whose entities have the order of the file: they are those of the model that have
the same centre and size, and bound the same volume. The numbers of the sub-shapes follow from the
BREP's tree.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Hashable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput
from fem_snh.mesh.gmsh_model import PhysicalGroup

#: What the lists and their entries are called, by dimension.
LISTS = ("vertices", "edges", "faces", "solids")
ENTRIES = ("vertex", "edge", "face", "solid")
#: Largest difference of centres and sizes of the same entity, relative to the largest coordinate.
_TOLERANCE = 1e-7
#: What a BREP calls vertices, edges, faces and solids.
_CODES = ("Ve", "Ed", "Fa", "So")

#: A chain of elementary transformations and their powers.
Location = tuple[tuple[int, int], ...]


def read(path: Path) -> tuple[str, list[int], list[PhysicalGroup]]:
    """Return the content of a file. Raises BadInput and OSError.

    Returns
    -------
    brep : str
        The shape.
    counts : list of int
        The number of vertices, edges, faces and solids.
    groups : list of PhysicalGroup
        The groups with elements: their ranks among all entries of the dimension. The name is empty
        without one, the tag -1.
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
    """Return a whole number, at least 0, that an element has as an attribute."""
    text = element.get(key, "")
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise BadInput(f"{element.tag}: {key} = '{text}': expected a whole number")
    return int(text)


def write_xao(path: str | Path) -> None:
    """Write gmsh's current model and its physical groups as an XAO file.

    It is a geometry of OpenCASCADE, with groups and without a mesh. gmsh 4.13 and later do so by
    themselves: ``gmsh.write("part.xao")``.

    Raises
    ------
    BadInput
        If the model has no such geometry, if entities of a group coincide with others, or if the
        file cannot be written.
    """
    import gmsh

    name = gmsh.model.getCurrent()
    with TemporaryDirectory(prefix="fem_snh-") as folder:
        file = Path(folder) / "shape.brep"
        try:
            gmsh.write(str(file))
        except Exception as error:  # gmsh raises no other
            raise BadInput(f"no geometry of OpenCASCADE to write: {error}") from None
        brep = file.read_text(encoding="utf-8")
        model = _Entities(gmsh)
        gmsh.model.add("fem_snh copy")
        try:
            gmsh.model.occ.importShapes(str(file), False)
            gmsh.model.occ.synchronize()
            copy = _Entities(gmsh)
        finally:
            gmsh.model.remove()
            gmsh.model.setCurrent(name)
    own, copies = _keys(model, copy)
    root = ET.Element("XAO", version="1.0", author="fem_snh")
    geometry = ET.SubElement(root, "geometry", name=name)
    ET.SubElement(geometry, "shape", format="BREP").text = f"\n{brep}"
    topology = ET.SubElement(geometry, "topology")
    for dim, numbers in enumerate(_numbers(brep)):
        if len(numbers) != len(copies[dim]):
            raise BadInput(f"gmsh has {len(copies[dim])} {LISTS[dim]}, its BREP {len(numbers)}")
        entries = ET.SubElement(topology, LISTS[dim], count=str(len(numbers)))
        for index, number in enumerate(numbers):
            values = {"index": str(index), "name": "", "reference": str(number)}
            ET.SubElement(entries, ENTRIES[dim], values)
    groups = ET.SubElement(root, "groups")
    for dim, tag in gmsh.model.getPhysicalGroups():
        called = gmsh.model.getPhysicalName(dim, tag) or f"G_{dim}D_{tag}"
        values = {"name": called, "dimension": ENTRIES[dim], "tag": str(tag)}
        group = ET.SubElement(groups, "group", values)
        places = defaultdict(list)
        for index, key in enumerate(copies[dim].values()):
            places[key].append(index)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            found = places[own[dim][entity]]
            if len(found) != 1:
                raise BadInput(
                    f"physical group '{called}': {len(found)} {LISTS[dim]} of the BREP are where "
                    f"number {entity} is: expected one"
                )
            ET.SubElement(group, "element", index=str(found[0]))
        group.set("count", str(len(group)))
    groups.set("count", str(len(groups)))
    ET.SubElement(root, "fields", count="0")
    try:
        ET.ElementTree(root).write(path, encoding="UTF-8", xml_declaration=True)
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror}") from None


class _Entities:
    """The entities of gmsh's current model.

    Attributes
    ----------
    shapes : list of dict
        By dimension and tag, bounding box, centre and size (10,), relative to the largest
        coordinate; zeros where an entity has no size.
    bodies : dict
        By dimension and tag, dimension and tag of the volumes, or else faces, that it bounds.
    """

    def __init__(self, gmsh: Any) -> None:
        model, occ = gmsh.model, gmsh.model.occ
        size = max(map(abs, model.getBoundingBox(-1, -1)))
        self.shapes: list[dict[int, npt.NDArray[np.float64]]] = [{}, {}, {}, {}]
        self.bodies: dict[tuple[int, int], set[tuple[int, int]]] = defaultdict(set)
        for dim in (3, 2, 1, 0):
            for _, tag in model.getEntities(dim):
                numbers = np.zeros(10)
                numbers[:6] = model.getBoundingBox(dim, tag)
                if dim and (mass := occ.getMass(dim, tag)) > 0:
                    numbers[6:] = *occ.getCenterOfMass(dim, tag), mass / size ** (dim - 1)
                self.shapes[dim][tag] = numbers / size
                if dim:
                    above = self.bodies.get((dim, tag), {(dim, tag)})
                    for entity in model.getBoundary([(dim, tag)], False, False):
                        self.bodies[entity] |= above


def _keys(*models: _Entities) -> list[list[dict[int, Hashable]]]:
    """Return, for each model, by dimension and tag, what is equal for the same entities.

    Numbers that differ by rounding are equal, which rounding each of them would not ensure.
    """
    same: dict[tuple[_Entities, int, int], int] = {}
    for dim in range(4):
        entities = [(model, dim, tag) for model in models for tag in model.shapes[dim]]
        if entities:
            points = np.array([model.shapes[dim][tag] for model, _, tag in entities])
            close = [np.abs(points - point).max(axis=1) <= _TOLERANCE for point in points]
            same.update(zip(entities, map(int, np.argmax(close, axis=1)), strict=True))
    return [
        [
            {
                tag: (
                    same[model, dim, tag],
                    frozenset((body[0], same[model, *body]) for body in model.bodies[dim, tag]),
                )
                for tag in model.shapes[dim]
            }
            for dim in range(4)
        ]
        for model in models
    ]


def _numbers(brep: str) -> list[list[int]]:
    """Return the numbers of vertices, edges, faces and solids, in the order of ``TopExp``."""
    children, kinds = _tree(brep)
    locations = _locations(brep)
    seen: dict[tuple[int, Location], int] = {}
    found: list[list[int]] = [[], [], [], []]
    last = brep[brep.rindex("*") + 1 :].split()
    stack = [(int(last[0][1:]), locations[int(last[1])])]
    while stack:
        shape = stack.pop()
        if shape in seen:
            continue
        seen[shape] = len(seen) + 1
        if kinds[shape[0]] in _CODES:
            found[_CODES.index(kinds[shape[0]])].append(seen[shape])
        stack += [
            (child, _product(shape[1], locations[location]))
            for child, location in reversed(children[shape[0]])
        ]
    return found


def _tree(brep: str) -> tuple[dict[int, list[tuple[int, int]]], dict[int, str]]:
    """Return the children of each shape of a BREP, with their locations, and its kind."""
    start = re.search(r"^TShapes (\d+)\s*$", brep, re.MULTILINE)
    if not start:
        raise BadInput("gmsh's BREP has no shapes")
    count = int(start[1])
    children, kinds = {}, {}
    records = brep[start.end() :].split("*")[:count]
    for number, record in zip(range(count, 0, -1), records, strict=True):
        # Flags of seven digits stand between the geometry and the children.
        geometry, _, rest = record.rpartition("\n\n")
        kinds[number] = geometry.split()[0]
        words = rest.split()[1:]
        children[number] = [
            (int(child[1:]), int(location))
            for child, location in zip(words[::2], words[1::2], strict=True)
        ]
    return children, kinds


def _locations(brep: str) -> list[Location]:
    """Return the locations of a BREP; the first is the identity."""
    words = iter(brep[brep.index("\nLocations") :].split()[1:])
    found: list[Location] = [()]
    for number in range(1, int(next(words)) + 1):
        if next(words) == "1":
            for _ in range(12):
                next(words)
            found.append(((number, 1),))
        else:
            found.append(_powers(words, found))
    return found


def _powers(words: Iterator[str], found: list[Location]) -> Location:
    """Return a product of powers of other locations."""
    result: Location = ()
    while base := int(next(words)):
        power = int(next(words))
        factor = found[base]
        if power < 0:
            factor = tuple((datum, -times) for datum, times in reversed(factor))
        for _ in range(abs(power)):
            result = _product(result, factor)
    return result


def _product(first: Location, second: Location) -> Location:
    """Return the product of two locations."""
    result = list(first)
    for datum, power in second:
        if result and result[-1][0] == datum:
            power += result.pop()[1]
        if power:
            result.append((datum, power))
    return tuple(result)
