"""Motions with a required accuracy: what it takes, and the true error of the goal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

from mpi4py import MPI

import fem_snh
from benchmarks import Row, split_list
from fem_snh import scenes
from fem_snh.contact.obstacle import Obstacle
from fem_snh.mesh.gmsh_model import session
from fem_snh.runs.scene_goals import scene_goals
from fem_snh.runs.setup import set_up
from fem_snh.scenes import Accuracy, Geometry, Gravity, Hold, MaterialChoice, Probe, Scene, Time
from fem_snh.scenes.builtin.bounce import GRAVITY, RADIUS

_GOALS = {"swing": "tip.z", "bounce": "body.mean.z"}
#: Levels end before one that would take longer [s].
_MAX_TIME = 3600.0
#: Order of the errors of a clamped cantilever with degree 2.
_SINGULAR_ORDER = 1.5
#: Cells along the diameter of the revolved ball, and the factor of its penalty's stiffness.
_REVOLVED, _STIFFER = (12, 16), 4.0


def rows(scenes: str = "swing,bounce", within: float = 0.01, exact: bool = True) -> Iterator[Row]:
    """Yield one row per scene and level, and one with the true error of the last.

    Parameters
    ----------
    scenes : str
        swing: a cantilever that falls from rest; bounce: a ball that falls and bounces.
    within : float
        The accuracy that is asked for.
    exact : bool
        Whether the true errors are found, against references that take minutes.

    Yields
    ------
    dict
        ``value``, ``error``, ``corrected``, ``bound`` of the goal; in the last row ``exact``,
        a reference with its relative uncertainty ``exact_error``, and ``true_error`` of the value
        that the last level knows best, and ``processor``, the processor seconds of all levels.
    """
    for name in split_list(scenes):
        goal, start, working = _GOALS[name], perf_counter(), process_time()
        asked = Accuracy(goals=[goal], within=within, max_time=_MAX_TIME)
        result = fem_snh.run(_scene(name, accuracy=asked), progress=False)
        seconds, record = perf_counter() - start, result.record["accuracy"]
        row: Row = {"processor": process_time() - working}
        for level in record["levels"]:
            about = {key: level[key] for key in ("cells", "dofs", "time_steps", "seconds")}
            yield {"scene": name, "goal": goal} | about | level["goals"].get(goal, {})
        last = record["levels"][-1]
        row |= {"scene": name, "reached": record["reached"], "seconds": seconds}
        yield row | (_truth(name, goal, last) if exact else {})


def _truth(name: str, goal: str, last: Any) -> Row:
    """Return a reference with its uncertainty, and the error of the last level against it."""
    exact, uncertain = _bounce_reference() if name == "bounce" else _swing_reference(last)
    best = last["goals"][goal]["corrected"]
    return {
        "exact": exact,
        "exact_error": uncertain / abs(exact),
        "true_error": abs(best - exact) / abs(exact),
    }


def _swing_reference(last: Any) -> tuple[float, float]:
    """Return the tip's displacement of smaller cells and steps, extrapolated, and by how much."""
    coarse, fine = 3, 5
    tips = []
    for number in (coarse, fine):
        scene = _scene("swing")
        assert scene.time is not None
        changes: Row = {"element": last["element"], "cells": number}
        changes["time"] = scene.time.model_copy(update={"steps": 160})
        result = fem_snh.run(scene.model_copy(update=changes), progress=False)
        tips.append(result.steps[-1]["probes"]["tip"][2])
    further = (tips[1] - tips[0]) / ((fine / coarse) ** _SINGULAR_ORDER - 1)
    return tips[1] + further, abs(further)


def _bounce_reference() -> tuple[float, float]:
    """Return the mean displacement of the ball as a body of revolution, and its uncertainty."""
    values = {
        key: _revolved_ball(*key)
        for key in ((_REVOLVED[0], _STIFFER), (_REVOLVED[1], 1.0), (_REVOLVED[1], _STIFFER))
    }
    coarse, soft, stiff = values.values()
    further = (stiff - soft) / (_STIFFER - 1)  # the error of a penalty is inverse to its stiffness
    return stiff + further, abs(stiff - coarse) + abs(further)


def _revolved_ball(cells: int, stiffer: float) -> float:
    """Return the mean displacement of the ball along its axis at the end.

    Newmark's method finds no solution of some steps with stiff penalties; generalised-alpha does.
    """
    ball = scenes.load("bounce")
    assert ball.time is not None
    with TemporaryDirectory() as folder:
        path = Path(folder) / "half_disc.msh"
        _write_half_disc(path, cells)
        ground = {"plane": {"point": [0, -2 * RADIUS, 0], "normal": [0, 1, 0]}}
        scene = Scene(
            name="ball",
            mesh=path,
            element="P2",
            kinematics="axisymmetric",
            material=ball.material,
            time=ball.time.model_copy(
                update={"steps": 800, "integrator": "generalized_alpha"},
            ),
            gravity=Gravity(vector=(0, -GRAVITY, 0)),
            obstacle=[Obstacle.model_validate({"name": "ground", "shape": ground})],
            accuracy=Accuracy(goals=["body.mean.y"]),
        )
        setup = set_up(MPI.COMM_WORLD, scene, stiffer=stiffer)
    for row in setup.stepper:
        assert row["converged"], row["reason"]
    (goal,) = scene_goals(setup)
    (value,) = goal.bind(setup.problem)()
    setup.destroy()
    return float(value)


def _write_half_disc(path: Path, cells: int) -> None:
    """Write a mesh of half a disc beside the y axis, of second order."""
    with session() as gmsh:
        shape = gmsh.model.occ
        disc = shape.addDisk(0, 0, 0, RADIUS, RADIUS)
        half = shape.addRectangle(0, -2 * RADIUS, 0, 2 * RADIUS, 4 * RADIUS)
        shape.intersect([(2, disc)], [(2, half)])
        shape.synchronize()
        surfaces = [tag for _, tag in gmsh.model.getEntities(2)]
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, surfaces), "body")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 2 * RADIUS / cells)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(path))


def _scene(name: str, **keys: Any) -> Scene:
    if name == "bounce":
        return scenes.load("bounce").model_copy(update=keys)
    return Scene(
        name="swing",
        mesh=Geometry(source="bar", parameters={"length": 5.0, "interface": 2.5}),
        cells=4,
        element="Q1P0",
        material=MaterialChoice(name="stable_neo_hookean", E=1e7, nu=0.45, density=1000.0),
        hold=[Hold(group="left")],
        gravity=Gravity(vector=(0, 0, -9.81)),
        probe=[Probe(name="tip", point=(5, 0.5, 0.5))],
        time=Time(duration=1.0, steps=40),
        **keys,
    )
