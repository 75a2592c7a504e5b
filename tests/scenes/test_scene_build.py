"""A scene is a program: `Scene.build` gives the arguments of the public classes."""

from __future__ import annotations

from typing import Any

import pytest

import fem_snh
from fem_snh import scenes
from fem_snh.problem.initial_state import initial_velocity, set_initial_state
from fem_snh.runs.scene_options import scene_options
from fem_snh.runs.setup import set_up
from fem_snh.scenes.build import build, make_mesh

#: Cells of the coarsest meshes. Scenes with bones follow them by a first guess of their own.
CELLS = {"biceps": 12, "elbow": 12, "modes": 3, "squash": 4, "stretch": 3}
BONES = ("biceps", "elbow", "hand", "torso")
SAME = ("load", "converged", "reason", "newton", "linear", "residual", "energy", "min_J")


def both_ways(name: str, comm: Any) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the rows of two steps of a run, and of the program that the scene builds."""
    scene = scenes.load(name)
    counts = scene.time.model_copy(update={"steps": 2}) if scene.time else 2
    update: dict[str, Any] = {"time" if scene.time else "steps": counts}
    if scene.cells is not None:
        update["cells"] = CELLS.get(name, 2)
    scene = scene.model_copy(update=update)
    mesh = make_mesh(comm, scene)  # gmsh does not make the same one of an octopus each time
    with scene_options(scene):
        setup = set_up(comm, scene, mesh=mesh)
        expected = list(setup.stepper)
        setup.destroy()
    made_by = fem_snh.DynamicProblem if scene.time else fem_snh.NonlinearProblem
    problem = made_by(**build(scene, comm, mesh).arguments)
    if scene.start:
        set_initial_state(problem._problem, scene.start)
        problem._write_solution()
    if scene.time and scene.start:
        problem.start(initial_velocity(problem._problem, scene.start))
    return expected, list(problem.steps(2))


@pytest.mark.mpi
@pytest.mark.parametrize("name", [name for name in scenes.names() if name not in BONES])
def test_a_scene_and_its_program_take_the_same_steps(name: str, comm: Any) -> None:
    expected, rows = both_ways(name, comm)
    assert [[row.get(key) for key in SAME] for row in rows] == [
        [row.get(key) for key in SAME] for row in expected
    ]


def test_flesh_on_bones_ends_in_the_same_state(comm: Any) -> None:
    expected, rows = both_ways("elbow", comm)
    assert rows[-1]["energy"] == pytest.approx(expected[-1]["energy"], rel=1e-9)
