"""Scenes that are asked for an accuracy, each with the reference of its goal.

They have stiff parts that meet at a point, interfaces, corners, changes of supports, small loaded
patches, nearly incompressible materials, contact, fluids, rigid parts, motions, and goals that are
small beside their vector. ``exact_goals.json`` has the references, which `benchmarks.exact_goals`
makes; a few are known in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log, sqrt
from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

from scipy.optimize import brentq

from benchmarks import Row, accuracy_cases, error_estimates
from benchmarks.graded_meshes import Sides, at, graded, write
from fem_snh import solver
from fem_snh.errors import BadInput
from fem_snh.problem.goals import bind_all, names_of
from fem_snh.runs.scene_goals import scene_goals
from fem_snh.runs.scene_options import scene_options
from fem_snh.runs.setup import set_up
from fem_snh.scenes import Scene
from fem_snh.scenes.builtin.tube import inflation_pressure

#: Tolerances of the references: of the solver, and of the penetration of contact.
TIGHT, PENETRATION = {"snes_scaled_tol": 1e-9}, 1e-6


class Grid(NamedTuple):
    """A body of boxes.

    Attributes
    ----------
    ends : tuple of tuples
        Along each axis, the coordinates of lines of the grid.
    sides, parts : mapping
        Groups of the boundary and of cells, as `write` has them.
    inside : callable, optional
        Which cells belong to the body.
    layers : int
        Cells along the last axis; default: as along the others.
    """

    ends: tuple[tuple[float, ...], ...]
    sides: Sides
    parts: Sides | None = None
    inside: Any = None
    layers: int = 0

    def write(self, path: Path, cells: int, power: float, simplices: bool) -> Path:
        """Write the mesh with cells that are graded to the lines."""
        axes = [graded(ends, cells, power) for ends in self.ends]
        if self.layers:
            axes[-1] = graded(self.ends[-1], self.layers, 1.0)
        write(path, axes, self.sides, self.inside, None, self.parts, simplices)
        return path


@dataclass(frozen=True)
class Asked:
    """A scene and its goal.

    Attributes
    ----------
    mesh : Grid or dict
        Or a built-in geometry.
    element, cells, power
        Those that are asked with: the power of the grading of a grid, 1 for equal cells.
    scene : dict
        Its other keys.
    goal : str
        The goal.
    exact : float, optional
        Its exact value.
    uncertainty : float
        That of this value, relative: one that is for an incompressible material.
    fine : tuple
        Otherwise element, cells of the meshes and power of the grading of the reference.
    grid : Grid, optional
        The mesh of the reference, if it is not that of the scene.
    """

    mesh: Any
    element: str
    cells: int
    scene: Row
    goal: str
    exact: float | None = None
    uncertainty: float = 0.0
    fine: tuple[str, tuple[int, ...], float] = ("Q2", (6, 12, 24, 48), 3.0)
    grid: Grid | None = None
    power: float = 1.0

    @property
    def meshes(self) -> tuple[int, ...]:
        """The cells of the meshes of the reference."""
        return self.fine[1]

    def build(self, folder: Path) -> Scene:
        """Return the scene; the mesh of a grid is written to a folder."""
        scene: Row = {"name": "asked", **self.scene, "element": self.element}
        if isinstance(self.mesh, Grid):
            path = folder / f"{self.element}_{self.cells}.msh"
            scene["mesh"] = self.mesh.write(path, self.cells, self.power, self.element[0] == "P")
        else:
            scene |= {"mesh": self.mesh, "cells": self.cells}
        return Scene.model_validate(scene)

    def reference(self, folder: Path, cells: int) -> float:
        """Return the goal on a mesh of the reference, with as many times more time steps."""
        element, meshes, power = self.fine
        scene = {**self.scene, "petsc": TIGHT}
        for key in {"obstacle", "contact"} & scene.keys():
            method = {"method": "augmented_lagrangian", "tolerance": PENETRATION}
            scene[key] = [table | method for table in scene[key]]
        if "time" in scene:
            steps = 2 * scene["time"]["steps"] * cells // meshes[0]
            scene["time"] = scene["time"] | {"steps": steps}
        fine = replace(self, element=element, cells=cells, power=power, scene=scene)
        return value_of(replace(fine, mesh=self.grid or self.mesh).build(folder), self.goal)


@dataclass(frozen=True)
class Estimated:
    """A scene of `error_estimates`: with a ratio, an element, cells and a goal."""

    name: str
    nu: float
    element: str
    cells: int
    goal: str
    exact = None

    @property
    def meshes(self) -> tuple[int, ...]:
        """The cells of the meshes of the reference."""
        return (4, 6, 8, 12) if self.name in _GRIDS else error_estimates.REFERENCES[self.name][0]

    def build(self, folder: Path) -> Scene:
        """Return the scene."""
        return error_estimates.scene_of(self.name, self.nu, self.element, self.cells)

    def reference(self, folder: Path, cells: int) -> float:
        """Return the goal on a mesh of the reference, in three dimensions mostly a graded one."""
        element = "Q2" if self.name == "bar" else error_estimates.REFERENCES[self.name][1]
        scene = error_estimates.scene_of(self.name, self.nu, element, cells)
        update: Row = {"petsc": TIGHT}
        if self.name in _GRIDS:
            path = _GRIDS[self.name].write(folder / f"{cells}.msh", cells, 2.0, False)
            update |= {"mesh": path, "cells": None}
        return value_of(scene.model_copy(update=update), self.goal)


@dataclass(frozen=True)
class Known:
    """A case of `accuracy_cases`."""

    name: str
    exact = None
    meshes = ()

    @property
    def goal(self) -> str:
        """The goal."""
        return accuracy_cases.CASES[self.name].goal

    def build(self, folder: Path) -> Scene:
        """Return the scene."""
        return accuracy_cases.CASES[self.name].scene()


def truth(name: str) -> tuple[float, float]:
    """Return the value of a case's goal and its uncertainty."""
    case = CASES[name]
    if isinstance(case, Asked) and case.exact is not None:
        return case.exact, case.uncertainty * abs(case.exact)
    value, relative = accuracy_cases.exact(name)
    return value, abs(value) * relative


def value_of(scene: Scene, goal: str) -> float:
    """Return any goal of a scene at the end of its steps."""
    scene = Scene.model_validate({**dict(scene), "accuracy": {"goals": [goal]}})
    with solver.petsc_failures(), scene_options(scene):
        setup = set_up(MPI.COMM_SELF, scene)
        goals = scene_goals(setup)
        evaluate = bind_all(goals, setup.problem)
        for _ in setup.stepper:
            pass
        if not setup.stepper.done:
            raise BadInput(f"{scene.name}: {setup.stepper.failure_message()}")
        value = dict(zip(names_of(goals), evaluate(), strict=True))[goal]
        setup.destroy()
    return float(value)


# --- the tables of scenes ------------------------------------------------------------------------


def one(nu: float = 0.3, name: str = "stable_neo_hookean", **more: float) -> Row:
    """Return a material with E = 1."""
    return {"material": {"name": name, "E": 1.0, "nu": nu, **more}}


def two(
    stiff: str, soft: str, contrast: float, nu: tuple[float, float] = (0.3, 0.3), **more: str
) -> Row:
    """Return the materials of two groups, the first one stiffer."""
    pairs = (stiff, contrast, nu[0]), (soft, 1.0, nu[1])
    name = {"name": "stable_neo_hookean", **more}
    return {"material": [name | {"group": g, "E": E, "nu": nu} for g, E, nu in pairs]}


def hold(*groups: str, **components: str) -> Row:
    """Return holds of all components, and of those of ``components``."""
    some = [{"group": group, "components": list(axes)} for group, axes in components.items()]
    return {"hold": [*({"group": group} for group in groups), *some]}


def move(group: str, *vector: float, axes: str = "xyz") -> Row:
    """Return the motion of a group."""
    return {"move": [{"group": group, "translate": vector, "components": list(axes)}]}


def pull(group: str, *vector: float) -> Row:
    """Return a dead load."""
    return {"traction": [{"group": group, "vector": _padded(vector)}]}


def probe(name: str, *point: float, **radius: float) -> Row:
    """Return a probe."""
    return {"probe": [{"name": name, "point": point, **radius}]}


def flat(kinematics: str = "plane_strain") -> Row:
    """Return the kinematics of a section."""
    return {"kinematics": kinematics}


def ball(group: str, center: tuple[float, ...], radius: float, *shift: float) -> Row:
    """Return a rigid ball that moves towards a group."""
    shape = {"sphere": {"center": _padded(center), "radius": radius}}
    sinks = {"shape": shape, "translate": _padded(shift)}
    return {"obstacle": [{"name": "press", "group": group, **sinks}]}


def _padded(vector: tuple[float, ...]) -> tuple[float, ...]:
    """Return three components."""
    return (*vector, 0.0)[:3]


def _sides(names: str, *ends: tuple[float, float]) -> dict[str, Any]:
    """Return the conditions of the sides of a box, two names for each axis."""
    places = [(axis, x) for axis, pair in enumerate(ends) for x in pair]
    return {name: at(*place) for name, place in zip(names.split(), places, strict=True)}


def _box(*ends: tuple[float, ...], **more: Any) -> Grid:
    """Return a grid whose sides have names."""
    names = "left right bottom top" if len(ends) == 2 else "left right front back bottom top"
    sides = _sides(names, *((line[0], line[-1]) for line in ends))
    return Grid(ends, sides | more.pop("sides", {}), **more)


def _checker(*ends: tuple[float, ...], layers: int = 0, volume: bool = False) -> Grid:
    """Return stiff and soft squares, or cubes, that alternate."""
    axes = 3 if volume else 2
    parts = {
        "stiff": lambda x: x[:, :axes].prod(axis=1) > 0,
        "soft": lambda x: x[:, :axes].prod(axis=1) < 0,
    }
    return _box(*ends, parts=parts, layers=layers)


def _pieces(axis: int, cut: float, first: str = "first", second: str = "second") -> dict[str, Any]:
    """Return two parts at both sides of a plane."""
    return {first: lambda x: x[:, axis] < cut, second: lambda x: x[:, axis] > cut}


def _half(side: str, cut: float, height: float, axis: int = 1) -> dict[str, Any]:
    """Return the part x < cut of a horizontal side."""
    up = at(axis, height)
    return {side: lambda x: up(x) & (x[:, 0] < cut)}


def pressed(stretch: float, nu: float) -> float:
    """Return the stress P of a Neo-Hookean bar, E = 1, with free sides."""
    mu, lam = 1 / (2 + 2 * nu), nu / (1 + nu) / (1 - 2 * nu)
    side = brentq(lambda b: mu * (b**2 - 1) + lam * log(stretch * b**2), 0.5, 2.0)
    return mu * (stretch - 1 / stretch) + lam * log(stretch * side**2) / stretch


def inflated(inner: float, outer: float) -> float:
    r"""Return the pressure over mu of an incompressible Neo-Hookean ball, by its stretches.

    .. math:: p/\mu = 2 (1/b - 1/a) + (b^{-4} - a^{-4}) / 2
    """
    return 2 * (1 / outer - 1 / inner) + (outer**-4 - inner**-4) / 2


#: What nu = 0.4999 changes of a pressure, about that over the bulk modulus.
_COMPRESSIBLE = 1e-4
_SQUARES = (-1.0, 0.0, 1.0)
_SQUARE, _BEAM = _box((0, 1), (0, 1)), _box((0, 2), (0, 1))
_CHECKER = _checker(_SQUARES, _SQUARES)
#: A square whose cells move along z alone: the potential of Keller 1964 (J. Math. Phys. 5,
#: 548-549), whose mean conductivity is the geometric mean of the two.
_ALONG_Z = _checker(_SQUARES, _SQUARES, (0.0, 0.5), layers=1)
_COLUMN = _checker(_SQUARES, _SQUARES, (0.0, 1.0), layers=1)
_OCTANTS = _checker(_SQUARES, _SQUARES, _SQUARES, volume=True)
_SUPPORTED = _box((0, 0.5, 1), (0, 1), sides=_half("held", 0.5, 0))
_PATCH = _box((0, 0.5, 2), (0, 1), sides=_half("patch", 0.5, 1))
_BRACKET = Grid(
    ((0, 1, 3), (0, 2, 3)),
    {"bottom": at(1, 0.0), "end": at(0, 3.0)},
    None,
    lambda x: (x[:, 0] < 1) | (x[:, 1] > 2),
)
_BAR = _box((0, 1, 2), (0, 1), (0, 1), parts=_pieces(0, 1))
_BLOCK = Grid(
    ((0, 25, 50), (0, 25, 50), (0, 50)),
    _sides("left right front back bottom top", (0, 50), (0, 50), (0, 50))
    | {"patch": lambda x: (x[:, 2] > 49.9) & (x[:, :2].max(axis=1) < 25)},
)
_PUNCH = Grid(
    ((0, 0.5, 1), (0, 1, 1.05, 2.05)),
    _sides("left right bottom top", (0, 1), (0, 2.05)) | {"under": at(1, 1.0), "over": at(1, 1.05)},
    {"body": lambda x: x[:, 1] < 1.02, "punch": lambda x: x[:, 1] > 1.02},
    lambda x: (x[:, 1] < 1) | ((x[:, 1] > 1.05) & (x[:, 0] < 0.5)),
)
_PULLED = hold("left") | move("right", 0.01, 0, 0)
_CLAMPED = hold("left") | move("right", 0.2, 0, 0)


def _shear_along_z(contrast: float) -> tuple[Row, float]:
    """Return the scene of the squares that move along z, and its force, 1/20 of the mean mu."""
    scene = two("stiff", "soft", contrast, name="neo_hookean")
    held = hold("left", stiff="xy", soft="xy") | move("right", 0, 0, 0.1, axes="z")
    return scene | held, sqrt(contrast) / 2.6 / 20


def _along_z(element: str, cells: int, contrast: float, power: float = 1.0) -> Asked:
    """Return the case of the squares that move along z."""
    scene, force = _shear_along_z(contrast)
    return Asked(_ALONG_Z, element, cells, scene, "right.force.z", force, power=power)


def _checkers(element: str, cells: int, contrast: float, goal: str, **more: Any) -> Asked:
    """Return the case of a pulled checkerboard in plane strain."""
    scene = two("stiff", "soft", contrast) | flat() | _PULLED | more.pop("scene", {})
    fine = ("Q2", (6, 12, 24, 48), 4.0) if contrast < 50 else ("Q2", (8, 16, 24, 32), 5.0)
    return Asked(_CHECKER, element, cells, scene, goal, fine=fine, **more)


_CUBE = _box((0, 1), (0, 1), (0, 1))
_GRIDS = {"twist": _CUBE, "shear": _CUBE, "bar": _BAR}
_EARLIER: dict[str, Estimated | Known] = {
    f"{case.name}, {case.goal}, nu {case.nu:g}": case
    for case in (
        Estimated("cook", 0.3, "Q1", 16, "corner.y"),
        Estimated("cook", 0.4999, "P1", 16, "corner.y"),
        Estimated("plane", 0.3, "P1", 8, "tip.x"),
        Estimated("plane", 0.4999, "P1", 8, "corner.y"),
        Estimated("plane", 0.49, "Q1P0", 16, "energy"),
        Estimated("sheet", 0.49, "Q1", 8, "tip.x"),
        Estimated("sheet", 0.3, "P2", 4, "corner.y"),
        Estimated("twist", 0.3, "Q1", 12, "energy"),
        Estimated("twist", 0.49, "Q1P0", 12, "top.force.z"),
        Estimated("twist", 0.4999, "P2P0", 4, "top.force.z"),
        Estimated("shear", 0.3, "P1", 8, "corner.x"),
        Estimated("shear", 0.4999, "Q1", 8, "corner.z"),
        Estimated("block", 0.4999, "Q2", 4, "energy"),
        Estimated("bar", 0.3, "Q1", 4, "end.z"),
        Estimated("tube", 0.4999, "Q1P0", 16, "inner.x"),
        Estimated("rod", 0.49, "Q1", 16, "energy"),
        Estimated("bushing", 0.4999, "Q2Q1", 8, "energy"),
    )
}
_EARLIER |= {name: Known(name) for name in ("stretch", "quarter turn", "bracket", "hertz")}
_SLIDES = hold(left="x", front="y", bottom="z")
_TIP = probe("tip", 2, 1, 0)
CASES: dict[str, Asked | Estimated | Known] = {
    **_EARLIER,
    # Stiff parts that meet at a point, or along a line.
    "squares 10, quadrilaterals": _checkers("Q1", 4, 10, "right.force.x", power=3.0),
    "squares 10, nu 0.49": _checkers(
        "P2P0", 2, 10, "right.force.x", scene=two("stiff", "soft", 10, (0.3, 0.49))
    ),
    "squares 100, triangles": _checkers("P2", 2, 100, "right.force.x"),
    "squares 100, graded": _checkers("Q1", 12, 100, "energy", power=6.0),
    "along z 10": _along_z("Q1", 4, 10, 3.0),
    "along z 100": _along_z("Q1", 8, 100, 6.0),
    "along z 1e4": _along_z("P2", 2, 1e4),
    "column 10": Asked(
        _COLUMN, "P2", 2,
        two("stiff", "soft", 10) | hold("left", stiff="z", soft="z")
        | move("right", 0.01, 0, 0),
        "right.force.x", fine=("Q2", (4, 8, 12, 16), 4.0),
    ),
    "octants 10": Asked(
        _OCTANTS, "P2", 1, two("stiff", "soft", 10) | _PULLED, "right.force.x",
        fine=("Q2", (4, 6, 8, 10), 3.0),
    ),
    # Interfaces, most of which end at a surface.
    "two halves 100": Asked(
        _box((0, 1, 2), (0, 1), parts=_pieces(0, 1)), "Q1", 8,
        two("first", "second", 100) | flat() | hold("left") | pull("right", 0, 5e-3) | _TIP,
        "tip.y", power=2.0,
    ),
    "two halves 1e4": Asked(
        _box((0, 1, 2), (0, 1), parts=_pieces(0, 1)), "P1", 2,
        two("first", "second", 1e4, (0.3, 0.49)) | flat() | hold("left")
        | move("right", 0.1, 0.1, 0) | {"steps": 2},
        "right.moment.z",
    ),
    "bar 10": Asked(
        {"source": "bar"}, "P1", 2,
        two("first", "second", 10, (0.4, 0.4)) | _CLAMPED, "left.force.x",
        fine=("Q2", (2, 4, 6, 8), 2.0), grid=_BAR,
    ),
    "bar 1e4": Asked(
        {"source": "bar"}, "Q1", 2,
        two("first", "second", 1e4, (0.4, 0.4)) | hold("left") | move("right", 0, 0, 0.3)
        | {"steps": 2},
        "energy", fine=("Q2", (2, 4, 6, 8), 2.0), grid=_BAR,
    ),
    "laminate 1e3": Asked(
        _box((0, 2), (0, 0.5, 1), parts=_pieces(1, 0.5)), "Q1", 8,
        two("first", "second", 1e3) | flat() | hold("left") | move("right", 0, 0.05, 0),
        "right.force.y", power=2.0,
    ),
    "core 100": Asked(
        _box((0, 0.3, 1), (0, 1), parts=_pieces(0, 0.3)), "P2", 2,
        two("first", "second", 100) | flat("axisymmetric") | hold("bottom", left="x")
        | move("top", 0, 0.02, 0),
        "top.force.y",
    ),
    # Corners, and changes of supports.
    "bracket, plane strain": Asked(
        {"source": "bracket"}, "Q1", 2,
        one(0.49) | flat() | hold("bottom") | pull("end", 0, -1e-3) | probe("tip", 3, 3, 0),
        "tip.y", grid=_BRACKET, fine=("Q2", (6, 12, 24, 48), 3.0),
    ),
    "bracket, plane stress": Asked(
        {"source": "bracket"}, "P2", 1,
        one(0.3) | flat("plane_stress") | hold("bottom") | move("end", 0, -0.3, 0) | {"steps": 2},
        "end.moment.z", grid=_BRACKET,
    ),
    "half held": Asked(
        _SUPPORTED, "P1", 2,
        one() | flat() | hold("held") | pull("top", 0.02, 0.01) | probe("tip", 1, 1, 0), "tip.x",
    ),
    "half held, nu 0.4999": Asked(
        _SUPPORTED, "P2P1", 1,
        one(0.4999) | flat() | hold("held") | move("top", 0.1, 0, 0) | {"steps": 2}, "energy",
        fine=("Q2Q1", (6, 12, 24, 48), 3.0),
    ),
    "half held cube": Asked(
        _box((0, 0.5, 1), (0, 1), (0, 1), sides=_half("held", 0.5, 0, 2)),
        "P2", 1, one() | hold("held") | pull("top", 0.02, 0, 0.01) | probe("tip", 1, 1, 1), "tip.z",
        fine=("Q2", (4, 6, 8, 12), 3.0),
    ),
    # A patch of a side that is loaded.
    "patch, nu 0.4999": Asked(
        _PATCH, "Q1P0", 8,
        one(0.4999) | flat() | hold("bottom", left="x") | pull("patch", 0, -0.1)
        | probe("tip", 2, 1, 0),
        "tip.x", fine=("Q2Q1", (6, 12, 24, 48), 2.0), power=1.5,
    ),
    "patch of revolution": Asked(
        _PATCH, "P2P0", 2,
        one(0.49) | flat("axisymmetric") | hold("bottom", left="x") | pull("patch", 0, -0.1),
        "patch.mean.y", fine=("Q2Q1", (6, 12, 24, 48), 2.0),
    ),
    "block": Asked(
        {"source": "block"}, "P1", 4,
        one(0.4) | hold(bottom="z", left="x", front="y") | pull("patch", 0, 0, -0.1)
        | probe("middle", 0, 0, 50),
        "middle.z", fine=("Q2", (2, 4, 6, 8), 2.0), grid=_BLOCK,
    ),
    # Nearly incompressible, and goals of other kinds.
    "bonded, nu 0.4999": Asked(
        _box((0, 2), (0, 0.5)), "P1", 2,
        one(0.4999) | flat() | hold("bottom") | move("top", 0, 0.025, 0), "top.force.y",
        fine=("Q2Q1", (6, 12, 24, 48), 3.0),
    ),
    "volume": Asked(
        {"source": "cube"}, "Q1", 4, one(0.2) | hold("left") | move("right", 0.5, 0, 0), "volume",
        fine=("Q2", (4, 6, 8, 12), 2.0), grid=_CUBE,
    ),
    "stress": Asked(
        _SQUARE, "P2P1", 2,
        one(0.49) | flat() | hold("bottom") | move("top", 0.05, 0, 0)
        | probe("inside", 0.4, 0.6, 0, radius=0.2),
        "inside.stress", fine=("Q2Q1", (6, 12, 24, 48), 2.0),
    ),
    # Contact.
    "ball": Asked(
        _SQUARE, "P2", 4,
        one() | flat() | hold("bottom", left="x") | ball("top", (0, 2), 1.0, 0, -0.1),
        "press.force.y", fine=("Q2", (16, 32, 64), 1.0),
    ),
    "ball of revolution": Asked(
        {"source": "cylinder", "parameters": {"radius": 1.0, "length": 1.0}}, "Q1", 8,
        one(0.45) | flat("axisymmetric") | hold("left")
        | ball("right", (0, 2), 1.0, 0, -0.1),
        "press.force.y", fine=("Q2", (32, 64, 128), 1.0),
    ),
    "plane": Asked(
        {"source": "cube"}, "P1", 2,
        one(name="neo_hookean") | _SLIDES
        | {"obstacle": [{"name": "press", "group": "top", "translate": [0, 0, -0.2],
                         "shape": {"plane": {"point": [0, 0, 1], "normal": [0, 0, -1]}}}]},
        "press.force.z", pressed(0.8, 0.3),
    ),
    "two blocks": Asked(
        {"source": "two_blocks"}, "Q1", 2,
        one(0.45, name="neo_hookean") | _SLIDES
        | {"contact": [{"groups": ["lower_top", "upper_bottom"]}]}
        | move("top", 0, 0, -0.3, axes="z"),
        "top.force.z", pressed(0.85, 0.45),
    ),
    "punch": Asked(
        _PUNCH, "P1", 4,
        two("punch", "body", 2) | flat() | hold("bottom", left="x")
        | move("top", 0, -0.08, 0, axes="y") | {"contact": [{"groups": ["under", "over"]}]},
        "top.force.y", fine=("Q2", (4, 8, 16), 2.0),
    ),
    # Fluids.
    "fluid in a tube": Asked(
        {"source": "tube", "parameters": {"section": 0}}, "Q1P0", 4,
        one(0.4999, name="neo_hookean") | flat()
        | {"symmetry": [{"group": "start"}, {"group": "end"}], "steps": 4}
        | {"cavity": [{"group": "inner", "volume": 0.25 * 3.141592653589793 * (1.5**2 - 1)}]},
        "inner.pressure", inflation_pressure(1.5, 1, 2) / 2.9998, _COMPRESSIBLE,
    ),
    "fluid in a shell": Asked(
        {"source": "shell"}, "P2P1", 4,
        one(0.4999, name="neo_hookean") | hold(**{f"{x} = 0": x for x in "xyz"})
        | {"cavity": [{"group": "inner", "volume": 3.141592653589793 / 6 * (1.2**3 - 1)}]}
        | {"steps": 2},
        "inner.pressure", inflated(1.2, (1 + (1.2**3 - 1) / 1.5**3) ** (1 / 3)) / 2.9998,
        _COMPRESSIBLE,
    ),
    # Rigid parts.
    "sleeve": Asked(
        {"source": "bushing", "parameters": {"section": 0}}, "Q1", 2,
        one(0.45) | flat() | hold("outer")
        | {"rigid": [{"group": "inner", "torque": [0, 0, 100.0], "force": [3, 0, 0],
                      "about": [0, 0, 0]}]} | {"steps": 2},
        "inner.rotation.z", fine=("Q2", (4, 8, 16), 1.0),
    ),
    "lid": Asked(
        _BEAM, "P1", 2,
        one() | flat() | hold("left") | {"rigid": [{"group": "right", "force": [0, -0.005, 0]}]},
        "right.displacement.y",
    ),
    "turned lid": Asked(
        {"source": "cube"}, "Q1P0", 2,
        one(0.49) | hold("bottom")
        | {"rigid": [{"group": "top", "torque": [0, 0, 0.03], "force": [0.01, 0, 0]}]},
        "top.rotation.z", fine=("Q2Q1", (4, 6, 8, 12), 2.0), grid=_CUBE,
    ),
    # In time.
    "swing": Asked(
        _BEAM, "P2", 1,
        one(density=1.0) | flat() | hold("left") | pull("right", 0, -2e-3) | probe("tip", 2, 1, 0)
        | {"time": {"duration": 4.0, "steps": 16}},
        "tip.y", fine=("Q2", (4, 8, 16), 2.0),
    ),
    "pulled rod": Asked(
        {"source": "cylinder", "parameters": {"radius": 0.5, "length": 1.0}}, "Q1", 8,
        one(density=1.0) | flat("axisymmetric") | hold("left")
        | {"traction": [{"group": "right", "vector": [0, 0.05, 0], "table": "ramp"}]}
        | {"table": [{"name": "ramp", "points": [[0, 0], [2, 1]]}]}
        | {"time": {"duration": 2.0, "steps": 16}},
        "right.mean.y", fine=("Q2", (8, 16, 32), 1.0),
    ),
    # Small beside their vector.
    "sheared": Asked(
        _SQUARE, "P2", 2,
        one() | flat() | hold("bottom") | pull("top", 0.01, 0) | probe("middle", 0.5, 1, 0),
        "middle.y",
    ),
    "nearly symmetric": Asked(
        _BEAM, "P2", 2,
        one() | flat() | hold("left") | pull("right", 0.1, 1e-4) | probe("middle", 1, 0.5, 0),
        "middle.y",
    ),
}  # fmt: skip
