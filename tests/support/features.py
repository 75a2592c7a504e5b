"""One small scene for each feature: what holds of every scene is tested with all of them."""

from __future__ import annotations

from typing import Any

import pytest
from barrier_problems import needs_ipctk
from bodies import PRESS
from bone_scenes import LOWER, UPPER, bar
from contact_scenes import slide
from interrupted_runs import STRETCH
from shells import SYMMETRIC, shell
from time_scenes import DOWN, SWING, TURN, in_time

from fem_snh import scenes
from fem_snh.scenes import Obstacle, Start

BACK: dict[str, Any] = {"duration": 0.3, "steps": 5, "integrator": "bdf2"}
DAMPED: dict[str, Any] = {
    "duration": 0.3, "steps": 4, "integrator": "generalized_alpha",
    "damping": {"mass": 0.1, "stiffness": 0.01},
}  # fmt: skip
_MATERIAL = {"name": "stable_neo_hookean", "E": 1e4, "nu": 0.3}
_LINKED = {"kind": "hinge", "axis": (0, 0, 1), "through": (2, 0.5, 0.5)}


def _scene(source: str = "cube", **tables: Any) -> scenes.Scene:
    common = {
        "name": source, "mesh": {"source": source}, "cells": 2, "element": "Q1", "steps": 3,
        "material": _MATERIAL, "petsc": {"snes_scaled_tol": 1e-10},
    }  # fmt: skip
    return scenes.Scene.model_validate(common | tables)


def _rocking(friction: float) -> scenes.Scene:
    floor = {"name": "floor", "shape": {"plane": {}}, "friction": friction}
    return in_time(
        {"duration": 0.6, "steps": 6, "integrator": "newmark"},
        cells=1, gravity=DOWN, start=Start(velocity=(1, 0, 0)),
        material={"name": "stable_neo_hookean", "E": 1e6, "nu": 0.3, "density": 1000.0},
        obstacle=[Obstacle.model_validate(floor)],
    )  # fmt: skip


_BLOCKS = _scene(
    "two_blocks",
    mesh={"source": "two_blocks", "parameters": {"upper_width": 1.4, "shift": -0.2}},
    hold=[{"group": "bottom"}],
    move=[{"group": "top", "translate": [0.0, 0.0, -0.2]}],
    contact=[{"groups": ["upper_bottom", "lower_top"], "method": "augmented_lagrangian"}],
)
_CLIP = {"mesh": {"source": "clip", "parameters": {"gap": 0.3}}, "cells": 1}
_JAWS = _scene(
    "clip", **_CLIP, self_contact={"method": "reference"},
    move=[{"group": "bottom", "translate": [0, 0, 0.25]},
          {"group": "top", "translate": [0.1, 0, -0.25]}],
)  # fmt: skip
_BARRIER = _scene(
    "clip",
    mesh={"source": "clip", "parameters": {"gap": 0.3, "arm": 2}},
    cells=1, steps=1, material=_MATERIAL | {"E": 1.0, "nu": 0.4, "density": 1.0},
    hold=[{"group": "bottom"}], move=[{"group": "upper_tip", "translate": [0.2, 0, -0.6]}],
    self_contact={"method": "ipc"},
    time={"duration": 2.0, "steps": 12, "integrator": "newmark"}, petsc={},
)  # fmt: skip
_WEIGHT = _scene(
    "bar",
    steps=1, material=_MATERIAL | {"density": 1000.0}, hold=[{"group": "left"}],
    gravity={"vector": [0, 0, -9.81]}, rigid=[{"group": "second", "force": [0, 200.0, 0]}],
    time={"duration": 0.3, "steps": 6, "integrator": "generalized_alpha"},
)  # fmt: skip
_HINGE = _scene(
    "bar", hold=[{"group": "left"}], rigid=[{"group": "second", "joint": _LINKED | {"torque": 90}}]
)
_LOADS = _scene(
    "bar",
    mesh={"source": "bar", "parameters": {"length": 2, "interface": 1}},
    material=[_MATERIAL | {"density": 1000}, _MATERIAL | {"E": 4e4, "density": 3000,
                                                         "group": "second"}],
    hold=[{"group": "left"}], gravity={"vector": [0, 0, -9.81], "table": "pulse"},
    pressure=[{"group": "right", "value": 500.0}], traction=[{"group": "top", "vector": [9, 0, 0]}],
    spring=[{"group": "bottom", "stiffness": 1e4}], nu_continuation=[0.2],
    table=[{"name": "pulse", "points": [[0, 0], [0.5, 1], [1, 0.5]]}],
)  # fmt: skip
_ROLLERS = _scene(
    hold=[{"group": "bottom", "components": ["z"]}],
    symmetry=[{"group": "left"}, {"group": "front"}],
    move=[{"group": "top", "components": ["z"], "translate": [0, 0, 0.5]}],
)
_BONES = bar(
    {"shape": UPPER},
    {"shape": LOWER, "rotate": {"axis": [0, 0, 1], "through": [1, 0.5, 0.5], "angle": 0.6}},
    steps=3, petsc={"snes_scaled_tol": 1e-11},
)  # fmt: skip
_LATTICE = _scene(
    mesh={"lattice": {"sphere": {"center": [0, 0, 0], "radius": 0.5}}, "cell": 0.25},
    cells=None,
    bone=[
        {"name": name, "shape": {"sphere": {"center": [x, 0, 0], "radius": 0.15}}, **motion}
        for name, x, motion in (("low", -0.3, {}), ("high", 0.3, {"translate": [0.1, 0.1, 0]}))
    ],
)
_TUBE = {"cells": 3, "element": "Q2Q1", "kinematics": "axisymmetric", "steps": 3, "nu": 0.4999}
_PRESSURES = {"element": "Q1P0", "cells": 6, "nu": 0.4999, "stretch": 1.4, "steps": 2}

#: On the ground from the fourth step on.
_BOUNCE = {"cells": 3, "friction": 0.3, "height": 0.05, "steps": 12, "time.duration": 0.3}
#: Scene, options, rows after which a run is cut off.
CASES: dict[str, tuple[Any, dict[str, Any], int]] = {
    "extrapolate": ("stretch", STRETCH, 3),
    "tangent": ("stretch", STRETCH | {"predictor": "tangent", "element": "P2"}, 2),
    "before its first step": ("stretch", STRETCH, 0),
    "pressure": ("stretch", STRETCH | {"element": "Q2Q1", "nu": 0.5}, 2),
    "cell pressures": ("stretch", _PRESSURES | {"static_condensation": False}, 1),
    "halved": (PRESS, {}, 4),
    "inverted": ("press", {"cells": 4, "element": "Q1", "nu": 0.45, "to": 0.01, "steps": 1}, 2),
    "traction": ("cook", {"cells": 3, "element": "Q1", "steps": 3}, 2),
    "axisymmetric": ("stretch", _TUBE, 1),
    "loads": (_LOADS, {}, 2),
    "symmetry": (_ROLLERS, {}, 2),
    "bones": (_BONES, {}, 2),
    "lattice": (_LATTICE, {}, 2),
    "hinge": (_HINGE, {}, 2),
    "cavity": (shell(SYMMETRIC), {}, 2),
    "friction": (slide(method="augmented_lagrangian", stiffness=1e-3), {}, 2),
    "contact": (_BLOCKS, {}, 1),
    "self-contact": (_JAWS, {}, 2),
    "two steps back": (in_time(BACK, **SWING), {}, 3),
    "damped, turned": (in_time(DAMPED, **TURN), {}, 2),
    "adaptive": (in_time({"duration": 0.4, "steps": 4, "tolerance": 1e-3}, **SWING), {}, 4),
    "weight": (_WEIGHT, {}, 3),
    "linearised": (in_time(BACK | {"integrator": "semi_implicit"}, **TURN), {}, 2),
    "bounce": ("bounce", _BOUNCE, 8),
    "rocking": (_rocking(0.0), {}, 3),
    "rocking with friction": (_rocking(0.3), {}, 3),
    "barrier": (_BARRIER, {}, 4),
}
every_feature = pytest.mark.parametrize(
    "case", [pytest.param(name, marks=[needs_ipctk] * (name == "barrier")) for name in CASES]
)


def scene_of(case: str) -> scenes.Scene:
    """Return the scene of a case."""
    scene, options, _ = CASES[case]
    return scenes.load(scene, **options)
