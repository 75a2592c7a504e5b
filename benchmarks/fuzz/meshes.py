"""Mesh files, as runs that hold and load what they can read of them."""

from __future__ import annotations

import itertools
import math
import tempfile
from pathlib import Path
from random import Random

from benchmarks.fuzz.family import Family
from benchmarks.fuzz.mutations import write

_SCENE = """\
mesh = "body.msh"
element = "{element}"
steps = 1
reactions = ["left"]
[material]
name = "stable_neo_hookean"
E = {E}
nu = 0.3
[[hold]]
group = "left"
[[traction]]
group = "right"
vector = [{traction}, 0, 0]
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


def write_mesh(
    kind: str,
    n: int,
    version: float,
    binary: bool,
    edge: float = 1.0,
    random: Random | None = None,
) -> bytes:
    """Return a cube of n^3 cubes as a gmsh file.

    Parameters
    ----------
    kind : {"tetrahedra", "hexahedra", "quadratic"}
        The cells.
    version : {2.2, 4.1}
        The format.
    edge : float
        The edge of the cube [length].
    random : Random, optional
        Numbers the nodes, and orders the elements of each kind, at random.
    """
    nodes, elements = _body(kind, n)
    nodes = [tuple(edge * x for x in node) for node in nodes]
    if random is not None:
        order = random.sample(range(len(nodes)), len(nodes))
        number = {old: new for new, old in enumerate(order, 1)}
        nodes = [nodes[old] for old in order]
        elements = [(*e[:3], [number[i - 1] for i in e[3]]) for e in elements]
        random.shuffle(elements)
        elements.sort(key=lambda e: e[:3])
    import gmsh

    gmsh.initialize([], readConfigFiles=False)
    try:
        options = {"General.Terminal": 0, "Mesh.MshFileVersion": version, "Mesh.Binary": binary}
        for key, value in options.items():
            gmsh.option.setNumber(key, value)
        for dim, tag, name in ((3, 1, "body"), (2, 2, "left"), (2, 3, "right")):
            gmsh.model.addDiscreteEntity(dim, tag)
            gmsh.model.addPhysicalGroup(dim, [tag], tag)
            gmsh.model.setPhysicalName(dim, tag, name)
        gmsh.model.mesh.addNodes(3, 1, range(1, len(nodes) + 1), [x for p in nodes for x in p])
        for _, tag, element, numbers in elements:
            gmsh.model.mesh.addElementsByType(tag, element, [], numbers)
        with tempfile.TemporaryDirectory() as folder:
            gmsh.write(f"{folder}/body.msh")
            return Path(folder, "body.msh").read_bytes()
    finally:
        gmsh.finalize()


def make_mesh(random: Random, folder: Path) -> list[str]:
    """Gmsh files of a cube, format 2.2 or 4.1, text or binary, any numbering, edge and modulus"""
    kind = random.choice(("tetrahedra", "tetrahedra", "hexahedra", "quadratic"))
    binary, edge, E = random.random() < 0.4, 10 ** random.uniform(-3, 3), 10 ** random.uniform(0, 9)
    version = random.choice((2.2, 4.1))
    data = write_mesh(kind, random.choice((1, 2)), version, binary, edge, random)
    state = write(random, folder / "body.msh", data, binary)
    element = {"tetrahedra": "P1", "hexahedra": "Q1", "quadratic": "P2"}[kind]
    scene = _SCENE.format(element=element, E=E, traction=0.01 * E)
    (folder / "scene.toml").write_text(scene)
    return [state, repr(0.01 * E * edge**2)]


def _run(arguments: list[str]) -> int:
    """Run the scene; the support of a whole mesh holds the traction times the area."""
    import fem_snh

    state, force = arguments[0], float(arguments[1])
    result = fem_snh.run("scene.toml", out="out", progress=False)
    if result.converged:
        reaction = result.steps[-1]["reactions"]["left"]
        assert all(map(math.isfinite, reaction))
        if state == "whole":
            assert math.dist(reaction, (-force, 0, 0)) < 1e-5 * force, (reaction, force)
    return 0 if result.converged else 1


FAMILIES = {"mesh": Family(make_mesh, _run, ("fem_snh.runs", "fem_snh.mesh.mesh"))}
