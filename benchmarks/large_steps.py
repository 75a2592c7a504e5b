"""Steps that are too large: the default beside the best way by hindsight.

Each scene applies its whole load in one step. The ways are the default; as many equal steps as
given, which is what halving would have found at no cost; a line search or a trust region alone;
limits on the L-BFGS iterations. Seconds are those of the processor, and compare within a scene.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from math import pi
from pathlib import Path
from typing import Any

from benchmarks import Row, split_list
from benchmarks.extremes import bodies
from benchmarks.extremes.cases import Case
from fem_snh.errors import choose
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Pressure, Reaction, Scene, Symmetry

_BAR = bodies.reference(bodies.bar)
#: Scene and its keywords.
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "twist": ("twist", {"cells": 10}),
    "stretch": ("stretch", {"cells": 10}),
    "cook": ("cook", {"force": 300.0}),
    "press": ("press", {"cells": 8, "to": 0.5}),
    "elbow": ("elbow", {"cells": 20, "predictor": "tangent"}),
    "contrast": (bodies.reference(bodies.inclusion), {"cells": 8, "contrast": 1e4}),
    "sheet": (_BAR, {"length": 1e-2, "cells": 16, "stretch": 0.2, "bend": 0.5}),
    "crush": ("crush", {"cells": 6, "to": "inverted", "noise": 0.01}),
    "scramble": ("scramble", {"cells": 8}),
    "bushing": ("bushing", {"cells": 4, "angle": pi, "axial": 0.0}),
    "dome": (f"{__file__}:dome", {}),
    "follower": (f"{__file__}:follower", {}),
}
#: Keywords and PETSc options of each way.
WAYS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "default": ({}, {}),
    **{f"{n} steps": ({"steps": n}, {}) for n in (2, 4, 8, 16)},
    "line search": ({"globalization": "linesearch"}, {}),
    "trust region": ({"globalization": "trust_region"}, {}),
    **{f"L-BFGS {n}": ({}, {"snes_lbfgs_max_it": n}) for n in (0, 40, 160)},
}
#: Largest relative difference of the energies of one equilibrium, and the energy of rest.
_SAME, _REST = 1e-4, 1e-9


def dome(cells: int = 8, pressure: float = 0.08) -> Scene:
    """A thin hemisphere, clamped at its rim, under a pressure beyond that of its buckling."""
    return Scene(
        name="dome",
        mesh=Geometry(source="shell", parameters={"layers": 1, "outer": 1.1}),
        cells=cells,
        element="Q2",
        material=MaterialChoice(name="stable_neo_hookean", E=3.0, nu=0.3),
        hold=[Hold(group="z = 0")],
        symmetry=[Symmetry(group="x = 0"), Symmetry(group="y = 0")],
        pressure=[Pressure(group="outer", value=pressure)],
    )


def follower(cells: int = 4, pressure: float = 0.02) -> Scene:
    """A cantilever, bent by a follower pressure on its top, whose edges are free."""
    return Scene(
        name="follower",
        mesh=Geometry(source="bar", parameters={"length": 6.0, "interface": 3.0}),
        cells=cells,
        element="Q1P0",
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.45),
        hold=[Hold(group="left")],
        pressure=[Pressure(group="top", value=pressure)],
        reactions=[Reaction(group="left")],
    )


def rows(scenes: str = "", ways: str = "", timeout: float = 300.0) -> Iterator[Row]:
    """Yield one row per scene and way, and for each scene with a default its ratio to the best.

    Parameters
    ----------
    scenes, ways : str
        Comma lists of `SCENES` and `WAYS`; default: all.
    timeout : float
        Limit of a run [s].

    Yields
    ------
    dict
        ``fails``: attempts that failed. ``energy``: without one, the largest displacement.
        ``same``: whether it is that of the most steps.
    """
    names = [choose("scene", name, SCENES) for name in split_list(scenes)] or list(SCENES)
    chosen = [choose("way", way, WAYS) for way in split_list(ways)] or list(WAYS)
    for name in names:
        _row(name, chosen[0], timeout)  # compiles the kernels
        done = {way: _row(name, way, timeout) for way in chosen}
        ended = [row["energy"] for row in done.values() if row["converged"]]
        steps = [done[way]["energy"] for way in chosen if "steps" in way and done[way]["converged"]]
        energy = (steps or ended or [None])[-1]
        for row in done.values():
            end = row["energy"]
            row["same"] = end is not None and abs(end - energy) <= max(_SAME * abs(energy), _REST)
            yield row
        good = {
            way: row["seconds"] for way, row in done.items() if row["converged"] and row["same"]
        }
        if "default" in done and good:
            best = min(good, key=lambda way: good[way])
            ratio = round(done["default"]["seconds"] / good[best], 2)
            yield {
                "scene": name,
                "best": best,
                "ratio": ratio,
                "ok": ratio <= 2 and "default" in good,
            }


def _row(name: str, way: str, timeout: float) -> Row:
    """Run a scene one way; return its row."""
    scene, values = SCENES[name]
    keys, petsc = WAYS[way]
    out = Path(tempfile.mkdtemp(prefix="fem-snh-large-steps-"))
    try:
        case = Case(name, scene, {"steps": 1} | values | keys, "", lambda *_: "", petsc=petsc)
        record, measured = case.run(out, timeout)
    finally:
        shutil.rmtree(out)
    steps = record.get("steps", [])
    good = bool(measured["converged"])
    row: Row = {"scene": name, "way": way, "dofs": record.get("dofs"), "converged": good}
    row |= {key: sum(step[key] for step in steps) for key in ("newton", "linear", "lbfgs")}
    row["fails"] = sum(not step["converged"] for step in steps)
    row["energy"] = steps[-1]["energy"] if good else None
    if good and row["energy"] is None:
        row["energy"] = steps[-1]["max_u"]
    row["seconds"] = round(record.get("processor_seconds", timeout), 2)
    return row
