"""Scenes whose loads, ratios, materials, elements and meshes are drawn at random, by families.

Each is small: a run to 1 % takes seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from random import Random
from types import MappingProxyType
from typing import Any, NamedTuple

import fem_snh
from benchmarks import Row, split_list
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.errors import choose
from fem_snh.scenes import Scene

_RATIOS = (0.0, 0.2, 0.3, 0.35, 0.4, 0.45, 0.48, 0.49, 0.495, 0.499, 0.4999)
_OF_PLANES = ("stable_neo_hookean", "neo_hookean", "neo_hookean_simo")
_MATERIALS = (
    *_OF_PLANES, "neo_hookean_ogden", "mooney_rivlin", "yeoh", "ogden", "gent", "hencky",
    "stable_arruda_boyce", "stable_fung", "fixed_corotational", "c2_neo_hookean", "extended_tube",
)  # fmt: skip
#: Materials without a volume term in J alone, and with one that cannot be inverted for a pressure.
_POINTWISE, _WITHOUT_PRESSURE = ("hencky",), ("c2_neo_hookean",)
_ELEMENTS = ("P1", "P2", "P2P0", "P2P1", "Q1", "Q1P0", "Q2", "Q2Q1")
_OF_SHEETS = ("P1", "P2", "Q1", "Q2")

#: Seeds of one family; other families have others, as their first draws are the same.
_SEEDS = 100_000

Drawn = tuple[Scene, list[str]]
_Points = dict[str, tuple[float, ...]]


def plane(draw: Random) -> Drawn:
    """Brackets and Cook's membrane in plane strain and plane stress."""
    kinematics = draw.choice(("plane_strain", "plane_stress"))
    elements = _OF_SHEETS if kinematics == "plane_stress" else _ELEMENTS
    scene: dict[str, Any] = {
        "kinematics": kinematics, "element": draw.choice(elements), "steps": 4,
        "material": {"name": draw.choice(_OF_PLANES), "E": 1.0, "nu": draw.choice(_RATIOS)},
    }  # fmt: skip
    across = draw.uniform(-1, 1)
    if draw.random() < 0.5:
        scene |= {"name": "bracket", "mesh": {"source": "bracket"}, "cells": draw.choice((1, 2))}
        size, foot = draw.uniform(5e-4, 6e-3), "bottom"
        if draw.random() < 0.6:
            scene["traction"] = [{"group": "end", "vector": [0.7 * size * across, -size, 0]}]
        else:
            scene["move"] = [{"group": "end", "translate": [70 * size * across, -100 * size, 0]}]
        points = {"tip": (3, 3, 0), "knee": (1, 2, 0)}
    else:
        scene |= {"name": "cook", "mesh": {"source": "cook"}, "cells": draw.choice((2, 4))}
        size, foot = draw.uniform(2e-3, 3e-2), "left"
        scene["traction"] = [{"group": "right", "vector": [0.2 * size * across, size, 0]}]
        points = {"corner": (48, 60, 0)}
    scene |= {"hold": [{"group": foot}], "reactions": [foot]} | _probes(points)
    goals = [f"{name}.{axis}" for name in (*points, f"{foot}.force") for axis in "xy"]
    return Scene.model_validate(scene), ["energy", *goals]


def solid(draw: Random) -> Drawn:
    """Brackets, cubes and cylinders in three dimensions, pulled, sheared, bent and twisted."""
    scene, points = _solid(draw, draw.choice((1, 2, 3))), _Points()
    body = draw.choice(("bracket", "cube", "cylinder"))
    shift = [draw.uniform(-0.3, 0.3) for _ in "xyz"]
    if body == "bracket":
        scene |= {"cells": 1, "mesh": _mesh(body, depth=draw.choice((1, 2)))}
        foot, moved, points = "bottom", "end", {"tip": (3, 3, 0), "knee": (1, 2, 0)}
    elif body == "cube":
        scene |= {"mesh": {"source": body}}
        foot, moved, points = "bottom", "top", {"tip": (1, 1, 1), "inside": (0.7, 0.4, 0.6)}
    else:
        length = draw.choice((1, 2))
        scene |= {"mesh": _mesh(body, length=length), "cells": draw.choice((3, 4))}
        foot, moved, points = "left", "right", {"inside": (0.6 * length, 0.2, 0.1)}
    name = f"{body} {draw.choice(('moved', 'turned', 'loaded'))}"
    if name.endswith("loaded"):
        largest = 0.006 if body == "bracket" else 0.05
        load = [largest * size / 0.3 for size in shift]
        scene["traction"] = [{"group": moved, "vector": load}]
    else:
        scene["move"] = [{"group": moved, "translate": shift}]
    if name.endswith("turned"):
        middle = {"bracket": (3, 2.5, 0.5), "cube": (0.5, 0.5, 1), "cylinder": (1, 0, 0)}[body]
        axis = (0, 0, 1) if body == "cube" else (1, 0, 0)
        turn = {"axis": axis, "angle": draw.uniform(0.1, 1.2), "through": middle}
        scene["move"][0] |= {"translate": [0.3 * size for size in shift], "rotate": turn}
    about = [draw.choice((0, 1)) for _ in "xyz"]
    scene |= {"name": name.replace(" ", "_"), "hold": [{"group": foot}]}
    stress = draw.choice(("stress", "inside.stress" if "inside" in points else "stress"))
    radius = 0.3 if stress == "inside.stress" else 0.0
    scene |= {"reactions": [{"group": foot, "about": about}]} | _probes(points, radius)
    return _checked(scene), ["energy", "volume", f"{foot}.force", f"{foot}.moment", *points, stress]


def revolved(draw: Random) -> Drawn:
    """Tubes, rods and bushings as bodies of revolution, most under a follower pressure."""
    scene, points = _solid(draw, draw.choice((2, 4))), _Points()
    body = draw.choice(("tube", "cylinder", "bushing"))
    load = draw.uniform(-0.05, 0.1)
    if body == "tube":
        sizes = {"inner": 1, "outer": draw.uniform(1.3, 2.5), "length": draw.uniform(0.5, 2)}
        scene |= {"mesh": _mesh(body, section=1, **sizes), "kinematics": "axisymmetric"}
        scene["pressure"] = [{"group": "inner", "value": load}]
        if draw.random() < 0.5:
            scene |= {"symmetry": [{"group": "start"}], "hold": [{"group": "end"}]}
            reaction = "end"
        else:
            scene |= {"symmetry": [{"group": "start"}, {"group": "end"}]}
            reaction = "start"
        points = {"inside": (1, 0, 0), "outside": (sizes["outer"], 0, 0)}
    elif body == "cylinder":
        length = draw.uniform(0.5, 2)
        scene |= {"mesh": _mesh(body, length=length), "kinematics": "axisymmetric"}
        scene |= {"cells": draw.choice((3, 4, 6)), "hold": [{"group": "left"}]}
        pull = [0, length * draw.uniform(-0.25, 1), 0]
        scene["move"] = [{"group": "right", "translate": pull}]
        if draw.random() < 0.5:
            scene["pressure"] = [{"group": "side", "value": load}]
        points, reaction = {"inside": (0.3, 0.4 * length, 0)}, "right"
    else:
        sizes = {"inner": 1, "outer": draw.uniform(1.5, 2.5), "length": draw.uniform(1, 3)}
        scene |= {"mesh": _mesh(body, **sizes), "kinematics": "axisymmetric_torsion"}
        turn = {"axis": (0, 1, 0), "angle": draw.uniform(0, 0.7)}
        push = [0, draw.uniform(0, 0.5), 0]
        scene["move"] = [{"group": "inner", "translate": push, "rotate": turn}]
        scene |= {"hold": [{"group": "outer"}]}
        if draw.random() < 0.5:
            scene["pressure"] = [{"group": "ends", "value": load}]
        points, reaction = {"inside": (1.3, 0.2, 0)}, "inner"
    scene |= {"name": body, "reactions": [{"group": reaction}]} | _probes(points, 0.2)
    goals = ["energy", "volume", f"{reaction}.force.y", *points, "stress", "inside.stress"]
    return _checked(scene), goals


def contrast(draw: Random) -> Drawn:
    """Bars of two materials, one of which is 10 to 1000 times as stiff."""
    scene = _solid(draw, draw.choice((1, 2)))
    stiff = 10 ** draw.uniform(1, 3)
    names = [draw.choice(_OF_PLANES) for _ in range(2)]
    groups = draw.sample(("first", "second"), 2)
    ratios = [draw.choice(_RATIOS) for _ in range(2)]
    if draw.random() < 0.5:
        ratios[1] = ratios[0]
    scene["material"] = [
        {"name": name, "E": modulus, "nu": nu, "group": group}
        for name, modulus, nu, group in zip(names, (1.0, stiff), ratios, groups, strict=True)
    ]
    scene |= {"name": "bar", "mesh": {"source": "bar"}, "hold": [{"group": "left"}]}
    vector = [draw.uniform(-1, 1) for _ in "xyz"]
    if draw.random() < 0.5:
        scene["traction"] = [{"group": "right", "vector": [0.02 * size for size in vector]}]
    else:
        scene["move"] = [{"group": "right", "translate": [0.3 * size for size in vector]}]
    points = {"tip": (2, 1, 1), "seam": (1, 0.5, 1)}
    scene |= {"reactions": [{"group": "left"}]} | _probes(points)
    volumes = [f"{group}.volume" for group in groups]
    goals = ["energy", *volumes, "left.force", "left.moment", *points, f"{groups[0]}.stress"]
    return _checked(scene), goals


def supported(draw: Random) -> Drawn:
    """Cubes with weight, on foundations, with symmetry planes, pressed by planes and spheres."""
    scene = _solid(draw, draw.choice((2, 3)))
    scene |= {"mesh": {"source": "cube"}}
    scene["material"] |= {"density": 1.0}
    points = {"tip": (1, 1, 1), "edge": (1, 0.5, 0.5)}
    goals = ["energy", "volume", *points]
    words = []
    if draw.random() < 0.5:
        words.append("symmetric")
        scene |= {"symmetry": [{"group": "left"}, {"group": "front"}]}
    if draw.random() < 0.5:
        words.append("foundation")
        stiffness = 10 ** draw.uniform(-1, 1.5)
        scene["spring"] = [{"group": "bottom", "stiffness": stiffness}]
    else:
        scene |= {"hold": [{"group": "bottom"}], "reactions": [{"group": "bottom"}]}
        goals += ["bottom.force", "bottom.moment"]
    if draw.random() < 0.5:
        words.append("weight")
        scene["gravity"] = {"vector": [0, 0, -draw.uniform(0.02, 0.3)]}
    if draw.random() < 0.7 or not words:
        depth = draw.uniform(0.02, 0.2)
        obstacle: dict[str, Any] = {"name": "press", "translate": [0, 0, -depth]}
        if draw.random() < 0.5:
            tilt = [draw.choice((0.0, draw.uniform(-0.1, 0.1))) for _ in "xy"]
            obstacle["shape"] = {"plane": {"point": [0.5, 0.5, 1], "normal": [*tilt, -1]}}
            words.append("plane")
        else:
            radius, middle = draw.uniform(0.5, 2), [draw.choice((0.0, 0.5)) for _ in "xy"]
            center = [*middle, 1 + radius]
            obstacle["shape"] = {"sphere": {"center": center, "radius": radius}}
            words.append("sphere")
        scene["obstacle"] = [obstacle | {"group": "top"}]
        goals.append("press.force.z")
    else:
        load = [draw.uniform(-0.1, 0.1) for _ in "xyz"]
        scene["traction"] = [{"group": "top", "vector": load}]
        words.append("loaded")
    scene |= {"name": "_".join(words)} | _probes(points)
    return _checked(scene), goals


def rubbing(draw: Random) -> Drawn:
    """Cubes and cylinders of revolution that planes and spheres press and rub, with friction."""
    body = draw.choice(("cube", "cube", "cylinder"))
    scene = _solid(draw, draw.choice((2, 3) if body == "cube" else (4, 6)))
    scene["steps"] = draw.choice((4, 8, 12, 16))
    words, depth, shape = [body], draw.uniform(0.03, 0.2), draw.choice(("plane", "sphere"))
    up, axes = (2, "xyz") if body == "cube" else (1, "y")
    top: list[float] = [0.5, 0.5, 1] if body == "cube" else [0, 1, 0]
    normal = [float(i == up) for i in range(3)]
    press: dict[str, Any] = {"plane": {"point": top, "normal": [-size for size in normal]}}
    if shape == "sphere":
        radius = draw.uniform(0.5, 3)
        center = [at + radius * size for at, size in zip(top, normal, strict=True)]
        press = {"sphere": {"center": center, "radius": radius}}
    obstacle = {"name": "press", "shape": press, "friction": draw.choice((0.1, 0.3, 0.6))}
    obstacle["translate"] = [-depth * size for size in normal]
    foot = "bottom"
    if body == "cube":
        scene |= {"mesh": {"source": body}}
        slide = [draw.uniform(-0.25, 0.25), draw.choice((0.0, draw.uniform(-0.25, 0.25))), 0]
        path = draw.choice(("at once", "pressed first", "there and back"))
        points: dict[str, list[tuple[float, float]]] = {
            "pressed first": [(0.5, 0), (1, 1)],
            "there and back": [(0.5, 1), (1, -0.5)],
        }
        move: dict[str, Any] = {"group": foot, "translate": slide}
        if path in points:
            scene["table"] = [{"name": "path", "points": [(0, 0), *points[path]]}]
            move["table"] = "path"
        if path == "pressed first":
            scene["table"].append({"name": "first", "points": [(0, 0), (0.5, 1), (1, 1)]})
            obstacle["table"] = "first"
        scene["move"] = [move]
        words.append(path.replace(" ", "_"))
    else:
        foot = "left"
        scene |= {"mesh": _mesh(body, length=1), "kinematics": "axisymmetric"}
        scene["hold"] = [{"group": foot}]
    tip = (1, 1, 1) if body == "cube" else (0.4, 0.8, 0)
    scene |= {"obstacle": [obstacle], "reactions": [{"group": foot}]} | _probes({"tip": tip})
    scene["name"] = "_".join([*words, shape])
    forces = [f"{name}.force.{axis}" for name in ("press", foot) for axis in axes]
    return _checked(scene), ["tip", "body.mean", "volume", *forces]


class _Body(NamedTuple):
    """A body that moves: its mesh, groups and points.

    Attributes
    ----------
    mesh : dict
        The key ``mesh``.
    cells : tuple of int
        Of which one is drawn.
    kinematics : str or None
        The key ``kinematics``.
    length, period : float
        Its size, and about its slowest period where E = 1 and the density is 1/length^2.
    up : int
        The component that gravity has.
    foot, loaded, whole : str
        The groups that is held, that is loaded, and of all cells.
    tip : tuple of float
        A probe.
    """

    mesh: dict[str, Any]
    cells: tuple[int, ...]
    kinematics: str | None
    length: float
    period: float
    up: int
    foot: str
    loaded: str
    whole: str
    tip: tuple[float, ...]


def moving(draw: Random) -> Drawn:
    """Bodies in time: in plane strain, of revolution and in three dimensions; some bounce."""
    name = draw.choice(("cube", "bar", "cook", "bracket", "tube", "cylinder"))
    body = _moving_body(draw, name)
    scene, words, goals = _solid(draw, draw.choice(body.cells)), [name], ["tip", "volume"]
    del scene["steps"]
    scene |= {"mesh": body.mesh, "kinematics": body.kinematics} | _probes({"tip": body.tip})
    scene["material"]["density"] = body.length**-2
    goals.append(f"{body.whole}.mean")
    duration = body.period * draw.uniform(0.15, 1.2)
    up = [float(i == body.up) for i in range(3)]
    if name in ("cube", "cylinder") and draw.random() < 0.4:
        words.append("bounces")
        gap, speed = draw.uniform(0.02, 0.2), draw.uniform(0.05, 0.4)
        duration = gap / speed + draw.uniform(0.5, 5)
        normal = list(up)
        if name == "cube":
            normal[0] = draw.choice((0.0, draw.uniform(-0.2, 0.2)))
        at = [-gap * size for size in up]
        plane = {"plane": {"point": at, "normal": normal}}
        ground = {"name": "ground", "shape": plane, "friction": draw.choice((0.0, 0.0, 0.3))}
        scene |= {"obstacle": [ground], "start": {"velocity": [-speed * size for size in up]}}
        if draw.random() < 0.5:
            scene["gravity"] = {"vector": [-draw.uniform(0.01, 0.1) * size for size in up]}
        goals.append("ground.force")
    else:
        _hold_and_load(draw, body, duration, scene, words, goals)
    damping = {"mass": draw.choice((0.0, draw.uniform(0, 2) / body.period))}
    damping["stiffness"] = draw.choice((0.0, 0.03 * draw.random() * body.period))
    scene["time"] = {
        "duration": duration, "steps": draw.choice((8, 16, 20, 24, 32, 48)), "damping": damping,
        "integrator": draw.choice(("newmark", "newmark", "generalized_alpha", "backward_euler")),
    }  # fmt: skip
    goals = draw.sample(goals, 2)
    if body.kinematics == "axisymmetric":  # radial forces and displacements on the axis are zero
        goals = [f"{g}.y" if g.endswith((".force", ".displacement")) else g for g in goals]
    return _checked(scene | {"name": "_".join(words)}), goals


def _moving_body(draw: Random, name: str) -> _Body:
    """Return a body by its name; of some the ratios are drawn."""
    if name == "cube":
        foot, loaded = draw.choice((("bottom", "top"), ("left", "right")))
        mesh = {"source": name}
        return _Body(mesh, (2, 3), None, 1, 7, 2, foot, loaded, "body", (1, 1, 1))
    if name == "bar":
        end, mesh = (2, 0.5, 1), {"source": name}
        return _Body(mesh, (1, 2), None, 1, 18, 2, "left", "right", "second", end)
    if name == "cook":
        mesh, corner = {"source": name}, (48, 60, 0)
        return _Body(mesh, (2, 4), "plane_strain", 48, 12, 1, "left", "right", "body", corner)
    if name == "bracket":
        mesh, corner = {"source": name}, (3, 3, 0)
        return _Body(mesh, (1, 2), "plane_strain", 1, 60, 1, "bottom", "end", "body", corner)
    length = draw.uniform(0.5, 2)
    if name == "tube":
        outer = draw.uniform(1.3, 2.5)
        mesh = _mesh(name, section=1, inner=1, outer=outer, length=length)
        middle = (1, length / 2, 0)
        return _Body(mesh, (2, 4), "axisymmetric", 1, 6, 1, "outer", "inner", "body", middle)
    mesh, inside = _mesh(name, length=length), (0.3, 0.8 * length, 0)
    period = 5 * length
    return _Body(mesh, (4, 6), "axisymmetric", 1, period, 1, "left", "right", "body", inside)


def _hold_and_load(
    draw: Random,
    body: _Body,
    duration: float,
    scene: dict[str, Any],
    words: list[str],
    goals: list[str],
) -> None:
    """Hold a body at its foot, by a spring or a motion, and load it; add words and goals."""
    axes = {None: (0, 1, 2), "plane_strain": (0, 1), "axisymmetric": (1,)}[body.kinematics]
    rise, fall = sorted(draw.uniform(0.1, 0.9) * duration for _ in range(2))
    points = [(0, 0), (rise, 1), (fall, draw.choice((1, 0, -0.5)))]
    history = {"table": "history"}
    foot = draw.choice(("held", "held", "sprung", "shaken"))
    words.append(foot)
    if foot == "sprung":
        stiffness = 10 ** draw.uniform(-0.5, 1.5) / body.length
        scene["spring"] = [{"group": body.foot, "stiffness": stiffness}]
    else:
        scene["reactions"] = [{"group": body.foot}]
        goals.append(f"{body.foot}.force")
        if body.kinematics != "axisymmetric":
            goals.append(f"{body.foot}.moment")
        if foot == "held":
            scene["hold"] = [{"group": body.foot}]
        else:
            shift = [0.1 * body.length * draw.uniform(-1, 1) * (i in axes) for i in range(3)]
            scene["move"] = [{"group": body.foot, "translate": shift} | history]
    slender = (body.period / 7) ** -2
    if foot != "shaken" or draw.random() < 0.3:
        kind = draw.choice(("traction", "gravity", "velocity", "rigid"))
        words.append(kind)
        size = [0.2 * slender * draw.uniform(-1, 1) * (i in axes) for i in range(3)]
        table = draw.choice(({}, history))
        if kind == "traction":
            scene["traction"] = [{"group": body.loaded, "vector": size} | table]
        elif kind == "gravity":
            vector = [body.length * part for part in size]
            scene["gravity"] = {"vector": vector} | table
        elif kind == "velocity":
            factor = body.length * slender**-0.5
            scene["start"] = {"velocity": [factor * part for part in size]}
        else:
            area = body.length ** (len(axes) - 1) if body.kinematics != "axisymmetric" else 1
            force = [area * part for part in size]
            mass = draw.choice((0.0, 0.3 * area / body.length))
            part: dict[str, Any] = {"group": body.loaded, "mass": mass, "force": force}
            scene["rigid"] = [part | ({"load_table": "history"} if table else {})]
            goals.append(f"{body.loaded}.displacement")
            if body.kinematics != "axisymmetric":
                goals.append(f"{body.loaded}.rotation")
    if "history" in str(scene):
        scene["table"] = [{"name": "history", "points": points}]


#: The families by their names.
FAMILIES: Mapping[str, Callable[[Random], Drawn]] = MappingProxyType(
    {
        family.__name__: family
        for family in (plane, solid, revolved, contrast, supported, moving, rubbing)
    }
)


def draw_scenes(families: str, first: int, count: int) -> Iterator[tuple[Row, Scene, list[str]]]:
    """Yield family, seed and element, the scene and its goals: ``count`` of each family.

    ``families`` is a comma list, ``first`` the first seed.
    """
    for family in split_list(families):
        for seed in range(first, first + count):
            scene, goals = random_scene(family, seed)
            about = {"family": family, "seed": seed, "scene": scene.name, "element": scene.element}
            yield about, scene, goals


def goals_of_levels(scene: Scene, goals: list[str], within: float, max_time: float) -> list[Row]:
    """Return the goals of each level of a run to an accuracy, as run.json has them."""
    accuracy = {"goals": goals, "within": within, "max_time": max_time}
    result = fem_snh.run(scene, accuracy=accuracy, progress=False)
    return [level["goals"] for level in result.record["accuracy"]["levels"]]


def random_scene(family: str, seed: int) -> Drawn:
    """Return a scene of a family, and the names of its goals."""
    number = list(FAMILIES).index(choose("families", family, FAMILIES))
    return FAMILIES[family](Random(seed + _SEEDS * number))


def _solid(draw: Random, cells: int) -> dict[str, Any]:
    """Return an element, a material and cells."""
    return {
        "element": draw.choice(_ELEMENTS), "steps": 4, "cells": cells,
        "material": {"name": draw.choice(_MATERIALS), "E": 1.0, "nu": draw.choice(_RATIOS)},
    }  # fmt: skip


def _mesh(source: str, **parameters: float) -> dict[str, Any]:
    return {"source": source, "parameters": parameters}


def _probes(points: Mapping[str, tuple[float, ...]], radius: float = 0.0) -> dict[str, Any]:
    """Return the key of a scene for points by their names."""
    near = {"radius": radius} if radius else {}
    rows = [{"name": name, "point": at} for name, at in points.items()]
    return {"probe": [row | (near if row["name"] == "inside" else {}) for row in rows]}


def _checked(scene: dict[str, Any]) -> Scene:
    """Return the scene, with another element if its materials do not support the volume term."""
    material = scene["material"]
    materials = material if isinstance(material, list) else [material]
    volume = ELEMENTS[scene["element"]].volume
    if volume != "pointwise" and any(entry["name"] in _POINTWISE for entry in materials):
        scene["element"] = scene["element"][:2]
    elif volume == "pressure" and any(
        entry["nu"] == 0 or entry["name"] in _WITHOUT_PRESSURE for entry in materials
    ):
        scene["element"] = {"P2P1": "P2P0", "Q2Q1": "Q1P0"}[scene["element"]]
    return Scene.model_validate(scene)
