"""Structured meshes that are graded towards edges and corners, for reference solutions.

Doubling the number of cells divides every cell, so values on them may be extrapolated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise, permutations, product
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
#: Conditions on the centres of the faces of the boundary, by the name of the group.
Sides = Mapping[str, Callable[[Array], Array]]

#: gmsh's element types of cells and their faces by dimension and the number of a cell's corners
#: (gmsh manual, MSH 2.2).
_TYPES = {(2, 4): (3, 1), (3, 8): (5, 3), (2, 3): (2, 1), (3, 4): (4, 2)}
#: Corners of a cell along each axis, in gmsh's order.
_CORNERS: dict[int, list[tuple[int, ...]]] = {
    1: [(0,), (1,)],
    2: [(0, 0), (1, 0), (1, 1), (0, 1)],
    3: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0),
        (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
}  # fmt: skip


def graded(ends: Sequence[float], cells: int, power: float) -> Array:
    """Return coordinates between each two of the ends, with cells that decrease towards the ends.

    Half-way between two ends the spacing is uniform for ``power = 1``; for more, the distance from
    an end is s^power, with s uniform.
    """
    s = np.linspace(0, 1, cells + 1)
    near = 0.5 * (2 * np.minimum(s, 1 - s)) ** power
    unit = np.where(s <= 0.5, near, 1 - near)
    pieces = [a + (b - a) * unit for a, b in pairwise(ends)]
    return np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])


def write(
    path: Path,
    axes: Sequence[Array],
    sides: Sides,
    inside: Callable[[Array], Array] | None = None,
    mapping: Callable[[Array], Array] | None = None,
    parts: Sides | None = None,
    simplices: bool = False,
) -> None:
    """Write a grid as a .msh file.

    Parameters
    ----------
    path : Path
        The file.
    axes : sequence of arrays
        Coordinates along each of 2 or 3 axes.
    sides : mapping
        The groups of the boundary.
    inside : callable, optional
        Of centres of cells (n, dim): whether they belong to the body.
    mapping : callable, optional
        Of coordinates (n, dim): where the nodes are.
    parts : mapping, optional
        The groups of cells, by conditions on their centres; default: all are ``body``.
    simplices : bool
        Whether quadrilaterals and hexahedra are divided into 2 triangles and 6 tetrahedra.
    """
    dim, shape = len(axes), tuple(map(len, axes))
    x: Array = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    numbers = np.arange(len(x)).reshape(shape)
    cells = np.stack([_shifted(numbers, corner).ravel() for corner in _CORNERS[dim]], axis=1)
    if inside is not None:
        cells = cells[inside(x[cells].mean(axis=1))]
    middles = x[cells].mean(axis=1)
    if simplices:
        cells, middles = _simplices(cells, dim), middles.repeat(len(_paths(dim)), axis=0)
    faces = _boundary(cells, dim)
    centres = x[faces].mean(axis=1)
    groups = {name: faces[holds(centres)] for name, holds in sides.items()}
    used, renumbered = np.unique(cells, return_inverse=True)
    cells = renumbered.reshape(cells.shape)
    x = x[used] if mapping is None else mapping(x[used])
    solids = {name: holds(middles) for name, holds in (parts or {"body": _everywhere}).items()}
    kind, face_kind = _TYPES[dim, cells.shape[1]]
    names, rows = list[str](), list[tuple[int, int, Array]]()
    for name, chosen in solids.items():
        names.append(f'{dim} {len(names) + 1} "{name}"')
        rows += [(kind, len(names), nodes) for nodes in cells[chosen]]
    for name, nodes in groups.items():
        names.append(f'{dim - 1} {len(names) + 1} "{name}"')
        rows += [(face_kind, len(names), face) for face in np.searchsorted(used, nodes)]
    padded = np.column_stack([x, np.zeros((len(x), 3 - dim))])
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names)), *names]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(x))]
    lines += [f"{i + 1} {p[0]:.17g} {p[1]:.17g} {p[2]:.17g}" for i, p in enumerate(padded)]
    lines += ["$EndNodes", "$Elements", str(len(rows))]
    for i, (element, tag, nodes) in enumerate(rows):
        lines.append(f"{i + 1} {element} 2 {tag} {tag} {' '.join(str(n + 1) for n in nodes)}")
    path.write_text("\n".join([*lines, "$EndElements", ""]), encoding="ascii")


def _shifted(numbers: Array, corner: tuple[int, ...]) -> Array:
    """Return the node numbers at one corner of every cell."""
    shape = numbers.shape
    return numbers[tuple(slice(i, n - 1 + i) for i, n in zip(corner, shape, strict=True))]


def _paths(dim: int) -> list[list[int]]:
    """Return the corners of each simplex of a cell: a path along its edges, one for each axis."""
    steps = np.eye(dim, dtype=int)
    paths = (np.cumsum([0 * steps[0], *steps[list(p)]], axis=0) for p in permutations(range(dim)))
    return [[_CORNERS[dim].index(tuple(corner)) for corner in path.tolist()] for path in paths]


def _simplices(cells: Array, dim: int) -> Array:
    """Return the simplices of the cells, (n, dim + 1), in the order of the cells."""
    return cells[:, np.array(_paths(dim))].reshape(-1, dim + 1)


def _everywhere(x: Array) -> Array:
    """Return True for each point."""
    return np.ones(len(x), dtype=bool)


def _boundary(cells: Array, dim: int) -> Array:
    """Return the faces of one cell alone."""
    corners, faces = _CORNERS[dim], list[Array]()
    if cells.shape[1] == dim + 1:
        faces = [np.delete(cells, i, axis=1) for i in range(dim + 1)]
    for axis, end in () if faces else product(range(dim), (0, 1)):
        order = [tuple(np.insert(c, axis, end)) for c in _CORNERS[dim - 1]]
        columns = np.array([corners.index(tuple(map(int, corner))) for corner in order])
        faces.append(cells[:, columns])
    found = np.concatenate(faces)
    _, first, counts = np.unique(
        np.sort(found, axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.asarray(found[first[counts == 1]])


def at(axis: int, value: float) -> Callable[[Array], Array]:
    """Return the condition that a coordinate has this value."""
    return lambda x: np.asarray(np.isclose(x[:, axis], value, rtol=0, atol=1e-12))
