"""Damaged mesh files, as runs that would hold and load what they can read of them."""

from __future__ import annotations

import itertools
import struct
from pathlib import Path
from random import Random

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import mutate

_SCENE = """\
mesh = "body.msh"
element = "{element}"
steps = 1
[material]
name = "stable_neo_hookean"
E = 1.0
nu = 0.3
[[hold]]
group = "left"
[[traction]]
group = "right"
vector = [0.01, 0, 0]
"""
#: The corners of a cube in gmsh's order, and the tetrahedra that share its diagonal.
_CUBE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
_SIX = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]
#: Edges whose midpoints are the nodes 4 to 9 of gmsh's quadratic tetrahedron.
_EDGES = [(0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)]
#: gmsh's numbers of the types of elements.
_TRIANGLE, _QUADRANGLE, _TETRAHEDRON, _HEXAHEDRON, _QUADRATIC = 2, 3, 4, 5, 11

Elements = list[tuple[int, int, int, list[int]]]


def _body(kind: str, n: int) -> tuple[list[tuple[float, ...]], Elements]:
    """Return the nodes and the elements (dimension, group, type, nodes from 1) of a cube."""
    grid = list(itertools.product(range(n + 1), repeat=3))
    number = {p: i for i, p in enumerate(grid, 1)}
    nodes: list[tuple[float, ...]] = [(x / n, y / n, z / n) for x, y, z in grid]
    elements: Elements = []
    middle: dict[tuple[int, int], int] = {}

    def between(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in middle:
            nodes.append(
                tuple((s + t) / 2 for s, t in zip(nodes[a - 1], nodes[b - 1], strict=True))
            )
            middle[key] = len(nodes)
        return middle[key]

    for x, y, z in itertools.product(range(n), repeat=3):
        corner = [number[x + a, y + b, z + c] for a, b, c in _CUBE]
        if kind == "hexahedra":
            elements.append((3, 1, _HEXAHEDRON, corner))
        for tetrahedron in _SIX if kind != "hexahedra" else ():
            four = [corner[i] for i in tetrahedron]
            ten = four + [between(four[i], four[j]) for i, j in _EDGES]
            quadratic = kind == "quadratic"
            elements.append(
                (3, 1, _QUADRATIC if quadratic else _TETRAHEDRON, ten if quadratic else four)
            )
    for group, side in ((2, 0), (3, n)):
        for y, z in itertools.product(range(n), repeat=2):
            square = [number[side, y + b, z + c] for b, c in ((0, 0), (1, 0), (1, 1), (0, 1))]
            if kind == "hexahedra":
                elements.append((2, group, _QUADRANGLE, square))
            else:
                for i, j in ((1, 2), (2, 3)):
                    elements.append((2, group, _TRIANGLE, [square[0], square[i], square[j]]))
    return nodes, elements


def write_mesh(kind: str, n: int, version: float, binary: bool) -> bytes:
    """Return a cube of n^3 cubes as a gmsh file.

    Parameters
    ----------
    kind : {"tetrahedra", "hexahedra", "quadratic"}
        The cells.
    version : {2.2, 4.1}
        The format.
    """
    nodes, elements = _body(kind, n)
    head = f"$MeshFormat\n{version} {int(binary)} 8\n".encode()
    if binary:
        head += struct.pack("<i", 1) + b"\n"
    names = '3\n3 1 "body"\n2 2 "left"\n2 3 "right"\n'
    head += f"$EndMeshFormat\n$PhysicalNames\n{names}$EndPhysicalNames\n".encode()
    write = _format_2 if version < 3 else _format_4
    return head + write(nodes, elements, binary)


def _numbers(binary: bool, kind: str, values: list[float]) -> bytes:
    """Return numbers as bytes, or as a line of text; ``kind`` is struct's, one letter for each."""
    if binary:
        return struct.pack("<" + kind, *values)
    return (" ".join(map(repr, values)) + "\n").encode()


def _format_2(nodes: list[tuple[float, ...]], elements: Elements, binary: bool) -> bytes:
    """Return the nodes and elements in format 2.2."""
    text = f"$Nodes\n{len(nodes)}\n".encode()
    for i, x in enumerate(nodes, 1):
        text += _numbers(binary, "i3d", [i, *x])
    text += f"\n$EndNodes\n$Elements\n{len(elements)}\n".replace("\n$E", "\n$E").encode()
    for i, (_, group, kind, list_of_nodes) in enumerate(elements, 1):
        tags: list[float] = [group, group, *list_of_nodes]
        if binary:  # a header for each element
            text += _numbers(True, f"4i{len(tags)}i", [kind, 1, 2, i, *tags])
        else:
            text += _numbers(False, "", [i, kind, 2, *tags])
    return text + b"\n$EndElements\n"


def _format_4(nodes: list[tuple[float, ...]], elements: Elements, binary: bool) -> bytes:
    """Return entities, nodes and elements in format 4.1."""
    box: list[float] = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    text = b"$Entities\n" + _numbers(binary, "4Q", [0, 0, 2, 1])
    for tag in (2, 3):
        text += _numbers(binary, "i6dQiQ", [tag, *box, 1, tag, 0])
    text += _numbers(binary, "i6dQiQ", [1, *box, 1, 1, 0]) + b"\n$EndEntities\n$Nodes\n"
    text += _numbers(binary, "4Q", [1, len(nodes), 1, len(nodes)])
    text += _numbers(binary, "3iQ", [3, 1, 0, len(nodes)])
    for i in range(1, len(nodes) + 1):
        text += _numbers(binary, "Q", [i])
    for x in nodes:
        text += _numbers(binary, "3d", list(x))
    text += b"\n$EndNodes\n$Elements\n"
    blocks = [list(block) for _, block in itertools.groupby(elements, lambda e: e[:3])]
    text += _numbers(binary, "4Q", [len(blocks), len(elements), 1, len(elements)])
    count = itertools.count(1)
    for block in blocks:
        dim, group, kind, _ = block[0]
        text += _numbers(binary, "3iQ", [dim, group, kind, len(block)])
        for *_, list_of_nodes in block:
            text += _numbers(binary, f"{1 + len(list_of_nodes)}Q", [next(count), *list_of_nodes])
    return text + b"\n$EndElements\n"


def make_mesh(random: Random, folder: Path) -> list[str]:
    """Gmsh files of tetrahedra or hexahedra, format 2.2 or 4.1, text or binary"""
    kind = random.choice(("tetrahedra", "tetrahedra", "hexahedra", "quadratic"))
    binary = random.random() < 0.4
    data = write_mesh(kind, random.choice((1, 2)), random.choice((2.2, 4.1)), binary)
    if random.random() < 0.98:  # some remain whole
        data = mutate(random, data, binary)
    (folder / "body.msh").write_bytes(data)
    element = {"tetrahedra": "P1", "hexahedra": "Q1", "quadratic": "P2"}[kind]
    (folder / "scene.toml").write_text(_SCENE.format(element=element))
    return ["run", "scene.toml", "--out", "out", "--quiet"]


FAMILIES = {"mesh": Family(make_mesh, preload=("fem_snh.runs", "fem_snh.mesh.mesh"))}
