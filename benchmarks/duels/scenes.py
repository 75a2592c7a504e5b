"""The scenes of the duels for every program: meshes, loads, conditions and the number to compare.

It needs numpy alone: the programs of the peers import it in environments of their own. The energy
is eq. 13 of Smith et al. 2018 with the Lamé constants of a scene,
psi = mu/2 (I_C - 3) - mu (J - 1) + (lam + mu)/2 (J - 1)^2.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from math import cos, pi, sin
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, Any]
#: Nodes of a cell in units of half its edges: the corners of a hexahedron in VTK's order.
CORNERS = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)]
#: The corners at the ends of its edges, in VTK's order.
EDGES = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 0),
    (4, 5),
    (5, 6),
    (6, 7),
    (7, 4),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
]
#: The nodes of hexahedra of degree 1, and of 20-node ones.
NODES = {
    1: np.array(CORNERS),
    2: np.array(CORNERS + [np.add(CORNERS[i], CORNERS[j]) // 2 for i, j in EDGES]),
}


def nowhere(x: Array) -> Array:
    """Select no node."""
    return np.zeros(len(x), dtype=bool)


#: Mean shape functions of corners and middles of edges, by the number of nodes of a cell or a face.
_CELL = {8: (1 / 8, 0), 20: (-1 / 8, 1 / 6)}
_FACE = {4: (1 / 4, 0), 8: (-1 / 12, 1 / 3)}


class Condition(NamedTuple):
    """One component of the displacement of some nodes, by coordinates X and the load."""

    nodes: Callable[[Array], Array]
    component: int
    value: Callable[[Array, float], Array]


class Part(NamedTuple):
    """A body: a lattice of cells in a unit cube that is mapped to coordinates [m, mm in hertz]."""

    cells: Callable[[int], tuple[int, int, int]]
    mapping: Callable[[Array], Array]


class Duel(NamedTuple):
    """A scene.

    Attributes
    ----------
    lam, mu : float
        Lamé constants at small strain [Pa; MPa with mm].
    parts : tuple of Part
        The bodies.
    conditions : tuple of Condition
        Of the displacement.
    goal : callable
        The number to compare, of the nodes' coordinates, displacements and forces (n, 3): the
        forces are internal ones without those of loads and contact.
    body_force, traction : tuple
        Per volume, and per area where ``loaded``.
    plane : tuple, optional
        Depth by which a rigid plane z = constant moves up into the body from its lowest point.
    scatter : float
        Volume in which the nodes are placed at random, relative to that of the body; 0: at rest.
    steps : int
        Load steps of programs that do not choose them.
    """

    lam: float
    mu: float
    parts: tuple[Part, ...]
    conditions: tuple[Condition, ...]
    goal: Callable[[Array, Array, Array], float]
    body_force: tuple[float, float, float] = (0, 0, 0)
    traction: tuple[float, float, float] = (0, 0, 0)
    loaded: Callable[[Array], Array] = nowhere
    plane: float = 0.0
    scatter: float = 0.0
    steps: int = 1

    def mesh(self, cells: int, degree: int = 1) -> tuple[Array, Array]:
        """Return points (n, 3) and hexahedra of 8 or 20 nodes, in VTK's order."""
        offsets, points, found, count = NODES[degree], [], [], 0
        for part in self.parts:
            shape = np.array(part.cells(cells))
            axes = [np.linspace(0, 1, 2 * n + 1) for n in shape]
            x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
            first = 2 * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
            at = first.reshape(-1, 1, 3) + offsets
            numbers = np.ravel_multi_index(tuple(np.moveaxis(at, -1, 0)), tuple(2 * shape + 1))
            used, local = np.unique(numbers, return_inverse=True)
            points.append(part.mapping(x[used]))
            found.append(local.reshape(numbers.shape) + count)
            count += len(used)
        return np.concatenate(points), np.concatenate(found)

    def prescribed(self, x: Array, load: float) -> tuple[Array, Array]:
        """Return the constrained degrees of freedom, 3 node + component, and their values."""
        dofs, values = [], []
        for nodes, component, value in self.conditions:
            at = np.flatnonzero(nodes(x))
            dofs.append(3 * at + component)
            values.append(value(x[at], load))
        unique, first = np.unique(np.concatenate(dofs), return_index=True)
        return unique, np.concatenate(values)[first]

    @property
    def E(self) -> float:
        """Return Young's modulus."""
        return self.mu * (3 * self.lam + 2 * self.mu) / (self.lam + self.mu)

    def touching(self, x: Array) -> Array:
        """Select the nodes of the surface of the ball, or between the blocks."""
        if self.plane:
            return np.abs(np.linalg.norm(x, axis=1) - 50) < 1e-6
        return np.abs(x[:, 2] - 1) < 1e-6

    def loads(self, x: Array, cells: Array) -> Array:
        """Return the nodal forces (n, 3) of the loads on cells that are parallelepipeds."""
        f = np.zeros_like(x)
        edges = x[cells[:, [1, 3, 4]]] - x[cells[:, [0]]]
        share = np.where(np.arange(cells.shape[1]) < 8, *_CELL[cells.shape[1]])
        weights = np.abs(np.linalg.det(edges))[:, None] * share
        np.add.at(f, cells, weights[..., None] * np.array(self.body_force))
        loaded = self.loaded(x)
        for cell in cells[loaded[cells].any(axis=1)]:
            face = cell[loaded[cell]]
            a, b, c = x[face[:3]]
            share = np.where(np.arange(len(face)) < 4, *_FACE[len(face)])
            area = np.linalg.norm(np.cross(b - a, c - a))
            f[face] += area * share[:, None] * np.array(self.traction)
        return f

    def start(self, x: Array) -> Array:
        """Return the first guess of the displacements (n, 3)."""
        u = np.zeros_like(x)
        if self.scatter:
            side = self.scatter ** (1 / 3)
            u = np.random.default_rng(0).uniform((1 - side) / 2, (1 + side) / 2, x.shape) - x
        dofs, values = self.prescribed(x, 1 / self.steps)
        u.flat[dofs] = values
        return u


def at(axis: int, value: float) -> Callable[[Array], Array]:
    """Return the function that selects nodes by one coordinate."""
    return lambda x: np.abs(x[:, axis] - value) < 1e-6


def zero(x: Array, load: float) -> Array:
    """Return no displacement."""
    return np.zeros(len(x))


def held(nodes: Callable[[Array], Array], components: Iterable[int] = (0, 1, 2)) -> list[Condition]:
    """Return conditions that fix components."""
    return [Condition(nodes, i, zero) for i in components]


def _turn(axis: int) -> Callable[[Array, float], Array]:
    """Return a component of a half turn about the vertical axis of the unit cube."""

    def value(x: Array, load: float) -> Array:
        c, s = cos(pi * load), sin(pi * load)
        arm = x[:, :2] - 0.5
        turned: Array = arm @ np.array([[c, s], [-s, c]]) - arm
        return turned[:, axis]

    return value


def _moment(x: Array, u: Array, f: Array) -> float:
    """Return the moment [N m] about the vertical axis of the cube that holds its top."""
    top = at(2, 1.0)(x)
    arm, force = (x + u)[top] - 0.5, f[top]
    return float((arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]).sum())


def _force(axis: int, value: float) -> Callable[[Array, Array, Array], float]:
    """Return the function of the vertical force on a plane of nodes."""
    return lambda x, u, f: float(f[at(axis, value)(x), 2].sum())


def _octant(x: Array) -> Array:
    """Map a unit cube to an octant of a ball of 50 mm, fine at its lowest point (0, 0, -50)."""
    y = np.column_stack([x[:, 0] ** 2.5, x[:, 1] ** 2.5, x[:, 2] ** 1.5 - 1])
    length = np.linalg.norm(y, axis=1)
    ball: Array = 50 * y * (np.abs(y).max(axis=1) / np.where(length > 0, length, 1))[:, None]
    return ball


def _cook(x: Array) -> Array:
    """Map a unit cube to a layer of Cook's membrane, as thick as a cell is not long [mm]."""
    s, t = x[:, 0], x[:, 1]
    return np.column_stack([48 * s, 44 * s + t * (44 - 28 * s), x[:, 2]])


def _tip(x: Array, u: Array, f: Array) -> float:
    """Return the vertical displacement of the membrane's upper corner [mm]."""
    return float(u[np.argmin(np.abs(x[:, :2] - [48, 60]).sum(axis=1)), 1])


def _corners(x: Array) -> Array:
    """Select four corners of the unit cube that are not in one plane."""
    corners = np.array([(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)])
    chosen: Array = (np.abs(x[:, None] - corners).max(axis=2) < 1e-6).any(axis=1)
    return chosen


def constants(E: float, nu: float) -> tuple[float, float]:
    """Return lambda and mu."""
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


CUBE = Part(lambda n: (n, n, n), lambda x: x)
#: Displacement of the top of the two blocks [m].
PRESSED = 0.1
SCENES = {
    "twist": Duel(
        *constants(1.0, 0.49),
        (CUBE,),
        (
            *held(at(2, 0.0)),
            *(Condition(at(2, 1.0), i, _turn(i)) for i in (0, 1)),
            *held(at(2, 1.0), [2]),
        ),
        _moment,
        steps=20,
    ),
    "bar": Duel(
        5e4,
        5e4,
        (Part(lambda n: (n, n, 5 * n), lambda x: x * [0.2, 0.2, 1]),),
        tuple(held(at(2, 1.0))),
        lambda x, u, f: float(-u[at(2, 0.0)(x), 2].mean()),
        body_force=(0, 0, -9810.0),
    ),
    "cook": Duel(
        *constants(240.565, 0.4999),
        (Part(lambda n: (n, n, 1), _cook),),
        (*held(at(0, 0.0)), *held(lambda x: np.ones(len(x), dtype=bool), [2])),
        _tip,
        traction=(0, 100 / 16, 0),
        loaded=at(0, 48.0),
        steps=4,
    ),
    "hertz": Duel(
        *constants(2e4, 0.3),
        (Part(lambda n: (n, n, n), _octant),),
        (*held(at(0, 0.0), [0]), *held(at(1, 0.0), [1]), *held(at(2, 0.0), [2])),
        _force(2, 0.0),
        plane=0.2,
    ),
    "blocks": Duel(
        *constants(1.0, 0.3),
        (CUBE, Part(lambda n: (n + 1, n + 1, n + 1), lambda x: x + np.array([0, 0, 1]))),
        (
            *held(at(0, 0.0), [0]),
            *held(at(1, 0.0), [1]),
            *held(at(2, 0.0), [2]),
            Condition(at(2, 2.0), 2, lambda x, load: np.full(len(x), -PRESSED * load)),
        ),
        _force(2, 2.0),
    ),
    "inverted": Duel(
        *constants(1.0, 0.49),
        (CUBE,),
        tuple(held(_corners)),
        lambda x, u, f: float(np.linalg.norm(u, axis=1).max()),
        scatter=2.0,
    ),
}


def main(solve: Callable[[Duel, int, int], dict[str, Any]]) -> None:
    """Solve the scene of the command line, SCENE DEGREE CELLS, and print one JSON object.

    ``solve`` returns coordinates ``x``, displacements ``u`` and internal forces ``f`` (n, 3), or
    ``number`` and ``unknowns``; ``newton`` and ``status``. The text of an error is a status.
    """
    name, degree, cells = sys.argv[1:]
    scene, start = SCENES[name], perf_counter()
    row: dict[str, Any] = {}
    try:
        row = solve(scene, int(degree), int(cells))
        if "number" not in row:
            x, u, f = (np.asarray(row.pop(key), dtype=float).reshape(-1, 3) for key in "xuf")
            row |= {"number": abs(scene.goal(x, u, f)), "unknowns": x.size}
        if not np.isfinite(row["number"]):
            row["number"] = None
    except Exception as error:  # the words of the peer are the result
        row |= {"number": None, "status": " ".join(f"{type(error).__name__}: {error}".split())}
    print("\n" + json.dumps({**row, "seconds": perf_counter() - start}))
