"""Runs to a required accuracy: refinement, transfer, decisions, and true errors."""

from __future__ import annotations

import json
from time import perf_counter

from mpi4py import MPI

import numpy as np
import pytest
from bodies import volumes
from cook_values import CORNER
from running import solve
from shells import SYMMETRIC, shell
from test_error_estimate import sheared
from test_goals_on_the_path import UP, loaded

import fem_snh
from benchmarks.accuracy_cases import exact
from fem_snh import _dolfinx, cache, scenes
from fem_snh.accuracy.goal_errors import Estimate, GoalError
from fem_snh.accuracy.levels import LevelRow, Levels
from fem_snh.cli import main
from fem_snh.mesh import mesh as meshes
from fem_snh.mesh.bisection import bisect, edge_lengths
from fem_snh.problem.state_notes import is_at_rest
from fem_snh.problem.transfer import LocatedPoints, evaluate
from fem_snh.runs.level_meshes import first_scene
from fem_snh.runs.progress import Progress
from fem_snh.scenes import Accuracy, Scene

mpi = pytest.mark.mpi


def at_corners(sizes, dim=3):
    """Lengths of edges at the corners of cells of wanted volumes."""
    return np.repeat(edge_lengths(sizes, dim)[:, None], dim + 1, axis=1)


def refined(source, **parameters):
    """A mesh of tetrahedra, its data, and the same refined near a corner."""
    mesh = meshes.generate(MPI.COMM_SELF, source, "tetrahedron", **parameters)
    data = meshes.gather(mesh)
    centres = data.x[data.cells[:, :4]].mean(axis=1)
    near = np.linalg.norm(centres - data.x.min(axis=0), axis=1) < 0.5
    sizes = volumes(data)
    return mesh, data, bisect(data, at_corners(np.where(near, sizes / 64, sizes)), 10**6)[0], near


@pytest.mark.one_debian
def test_bisection_leaves_no_hanging_nodes():
    """Each facet is of two cells, or in one of the groups on the boundary of the cube."""
    _, data, finer, _ = refined("cube", cells=2)
    assert len(finer.cells) > 4 * len(data.cells)
    assert volumes(finer).sum() == pytest.approx(1.0, rel=1e-12)
    corners = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]
    facets = np.sort(finer.cells[:, corners].reshape(-1, 3), axis=1)
    _, counts = np.unique(facets, axis=0, return_counts=True)
    groups = {group.name: group for group in finer.groups}
    sides = [groups[name] for name in ("left", "right", "bottom", "top", "front", "back")]
    assert (counts == 1).sum() == sum(len(side.entities) for side in sides)
    assert counts.max() == 2
    left = finer.x[groups["left"].entities]
    assert np.abs(left[..., 0]).max() < 1e-15
    edges = left[:, 1:] - left[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    assert areas.sum() == pytest.approx(1.0, rel=1e-12)


def test_bisection_is_where_it_is_wanted():
    _, data, finer, near = refined("cube", cells=4)
    wanted = volumes(data)[near].min() / 64
    centres = finer.x[finer.cells].mean(axis=1)
    inside = np.linalg.norm(centres - finer.x.min(axis=0), axis=1) < 0.35
    far = np.linalg.norm(centres - finer.x.max(axis=0), axis=1) < 0.5
    assert volumes(finer)[inside].max() <= 2**0.5 * wanted * (1 + 1e-12)
    assert volumes(finer)[far].min() == pytest.approx(volumes(data).min(), rel=1e-9)


def test_cells_of_degree_2_stay_on_their_curved_faces():
    mesh, _, finer, _ = refined("cylinder", cells=3, order=2)
    other = meshes.distribute(MPI.COMM_SELF, "refined", lambda: finer)
    assert other.num_cells > 4 * mesh.num_cells
    assert meshes.volume(other.domain) == pytest.approx(meshes.volume(mesh.domain), rel=1e-9)
    side = next(group for group in finer.groups if group.name == "side")
    radii = np.hypot(*finer.x[np.unique(side.entities)][:, 1:].T)
    # Parabolas for arcs of 45 degrees; chords have 0.462.
    assert 0.494 < radii.min() < radii.max() < 0.5 + 1e-12


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize(("cell", "degree"), [("tetrahedron", 2), ("hexahedron", 1)])
def test_a_field_is_interpolated_on_another_mesh(cell, degree):
    """Exactly, if it is a polynomial of the element; also at points of other ranks."""
    comm = MPI.COMM_WORLD
    mesh = meshes.generate(comm, "cube", cell, cells=3)
    V = _dolfinx.function_space(mesh.domain, degree, (3,))
    u = _dolfinx.function(V, "u")

    def field(x):
        return np.stack([x[0] ** degree + x[1], x[2], 1 - x[1] ** degree])

    u.interpolate(field)
    points = np.random.default_rng(comm.rank).random((40, 3))
    assert np.abs(evaluate(u, points) - field(points.T).T).max() < 1e-10


@mpi
def test_a_point_beside_much_smaller_cells_is_in_its_own():
    """Their centres are nearer than that of its own cell."""
    mesh = meshes.generate(MPI.COMM_WORLD, "cube", "tetrahedron", cells=6)
    x = mesh.domain.geometry.x
    below = x[:, 2] < 0.7
    x[:, 2] = np.where(below, 1e-3 * x[:, 2], 7e-4 + (x[:, 2] - 0.7) / 0.3 * (1 - 7e-4))
    u = _dolfinx.function(_dolfinx.function_space(mesh.domain, 1, (3,)), "u")
    u.interpolate(lambda x: x)
    points = np.random.default_rng(MPI.COMM_WORLD.rank).random((200, 3))
    located = LocatedPoints(mesh.domain, points)
    assert located.inside.all()
    assert np.abs(located.values(u) - points).max() < 1e-12


@pytest.mark.parametrize("found", [0.3, 0.5, 0.8, 1.0, 1.5, 2.5])
@pytest.mark.parametrize("ratio", [0.15, 0.35, 0.7])
def test_bounds_hold_where_estimates_find_a_part_of_the_error(found, ratio):
    """From the second level on, whatever part it is: how the value changes tells it.

    At the re-entrant corner of a bracket in plane stress estimates on coarse meshes find 0.55.
    """
    levels = Levels(1e-4, dim=2)
    for k in range(3):
        true = 0.01 * ratio**k
        row = LevelRow("P2", 2, 8 * 4**k, 64 * 4**k, fineness=2.0**k)
        error = found * true
        goal = GoalError(1 - true, error, 1.0, {"mesh": error}, {"mesh": 0.5 * abs(error)})
        estimate = Estimate(goals={"a": goal})
        levels.measure(row, estimate)
        levels.add(row, estimate)
        goal = levels.rows[-1].goals["a"]
        if k == 0:
            assert goal.bound is None and not levels.reached
            continue
        assert goal.theta == pytest.approx(1 / found)
        if 1 / 1.5 <= found <= 2:  # what an estimate may miss anyway is the bound
            left = 0.25 if k == 1 else 0.0625  # one effectivity: order p; two: order 2p
            most = max(true, left * true / ratio)
            assert goal.bound == pytest.approx(0.5 * found * most, rel=1e-9)
        assert abs(goal.corrected - 1) <= goal.bound * (1 + 1e-9)
        if k == 2 and found < 1 / 1.5:  # twice on one side: the measured error is added
            assert goal.corrected == pytest.approx(1, abs=1e-12)


@pytest.mark.one_debian
@mpi
def test_a_force_without_contact_is_not_within_the_request(capsys):
    """The bulging cube touches the ground on finer cells: a force of 1e-11 N was within 20 %."""
    comm = MPI.COMM_WORLD
    scene = scenes.load("press", cells=2, to=0.7, element="Q1P0", steps=1)
    scene = scene.model_copy(update={"accuracy": Accuracy(within=0.2)})
    result = fem_snh.run(scene, comm=comm)
    level, _ = result.record["accuracy"]["levels"]
    assert "plate.force.z" in level["goals"] and "ground.force.z" not in level["goals"]
    assert result.record["accuracy"]["without_contact"] == ["ground.force"]
    assert result.goals["ground.force.z"]["error"] is None
    line = "ground.force 0, no estimate: nothing touches on these cells, but finer ones may"
    assert line in result.estimate.lines()
    if comm.rank == 0:
        shown = capsys.readouterr().out
        assert line in shown and "every goal but ground.force, without an estimate, is" in shown
    # Who names the goal has finer cells instead.
    levels = Levels(0.2, named=True)
    levels.add(LevelRow("Q1P0", 1, 8, 81, 1.0), result.estimate)
    assert not levels.reached and levels.refinement() == 2
    assert levels.rows[0].reason.startswith("ground.force.x: nothing touches on these cells")


def pressed(shape):
    """A cube of 8 cells on a foundation, pressed by an obstacle."""
    keys = {"name": "press", "mesh": {"source": "cube"}, "cells": 2, "element": "Q1P0", "steps": 1}
    keys |= {"material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.2}}
    keys |= {"spring": [{"group": "bottom", "stiffness": 0.1}]}
    obstacle = {"name": "plate", "shape": shape, "translate": [0, 0, -0.12], "group": "top"}
    return Scene.model_validate(keys | {"obstacle": [obstacle]})


@mpi
def test_a_contact_that_is_narrower_than_a_cell_takes_two_levels(comm):
    """A sphere touches one node of the first level, whose force was said to be 1.2 % off: 5.7 %."""
    sphere = {"sphere": {"center": [0.5, 0.5, 2.6], "radius": 1.6}}
    accuracy = {"goals": ["plate.force.z"], "within": 0.02}
    result = fem_snh.run(pressed(sphere), comm=comm, accuracy=accuracy, progress=False)
    levels = [level["goals"]["plate.force.z"] for level in result.record["accuracy"]["levels"]]
    assert len(levels) > 2 and result.record["accuracy"]["reached"]
    for level in levels[1:]:
        assert abs(level["corrected"] - levels[-1]["corrected"]) < level["bound"]


def test_each_level_in_time_differs_from_the_last():
    """What is left as it is adds up to less than the request."""
    for mesh, steps in ((0.0024, 0.0024), (0.02, 0.0001), (0.0001, 0.02), (0.012, 0.003)):
        levels = Levels(0.01)
        for value in (1.0, 1.0 + mesh + steps):
            parts = {"mesh": mesh, "time steps": steps}
            missed = {source: 0.5 * part for source, part in parts.items()}
            goal = GoalError(value, mesh + steps, 1.0, parts, missed)
            row = LevelRow("Q2", 2, 64, 500, 1.0, steps=10)
            estimate = Estimate(goals={"a": goal})
            levels.measure(row, estimate)
            levels.add(row, estimate)
        assert levels.reached or levels.shorter_steps() > 1 or not levels.mesh_suffices


@pytest.mark.parametrize(
    ("element", "nu", "cells", "asked", "keep", "used"),
    [
        ("Q1P0", 0.3, 8, 0.02, True, "Q1P0"),
        ("Q1", 0.4999, 8, 0.02, True, "Q1P0"),
        ("P1", 0.3, 4, 0.03, True, "P1"),
        ("Q1P0", 0.3, 16, 0.005, False, "Q2"),
        ("Q1", 0.4999, 16, 0.005, False, "Q2Q1"),
        ("P1", 0.3, 16, 0.003, False, "P2"),
    ],
)
def test_the_true_error_is_within_the_request(element, nu, cells, asked, keep, used, tmp_path):
    """Hexahedra by their number; tetrahedra where the error is; degree 1 is raised."""
    keys = {"accuracy.goals": "corner.y", "accuracy.within": asked, "out": tmp_path / "run"}
    keys |= {"kinematics": "layer", "accuracy.keep_element": keep}
    result = solve("cook", element=element, nu=nu, cells=cells, **keys)
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    accuracy = record["accuracy"]
    assert accuracy["reached"] and result.record["accuracy"] == accuracy
    assert record["element"] == used
    levels = accuracy["levels"]
    assert len(levels) > 1
    assert [level["cells"] for level in levels] == sorted({level["cells"] for level in levels})
    # Only the first level follows the load steps.
    assert len(record["steps"]) == 1 and record["cells"] == levels[-1]["cells"]
    goal = levels[-1]["goals"]["corner.y"]
    corner = CORNER[nu]["corner.y"]
    error = abs(goal["corrected"] - corner) / corner
    assert error <= min(asked, goal["relative"])


def test_a_displacement_at_a_corner_that_a_coarse_mesh_resolves_badly():
    """Estimates find neither size nor sign of the knee's error, so that its bounds are wide.

    On fine cells the corner is unstable, so that it has no limit. With 63,245 cells the values are
    these, with bounds of 0.03 and 0.004 %.
    """
    scene = {
        "mesh": {"source": "bracket"}, "cells": 2, "element": "Q2", "kinematics": "plane_stress",
        "name": "bracket", "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.4},
        "hold": [{"group": "bottom"}], "steps": 4,
        "traction": [{"group": "end", "vector": [0.0037944977, -0.0058229, 0]}],
        "probe": [{"name": "tip", "point": [3, 3, 0]}, {"name": "knee", "point": [1, 2, 0]}],
        "accuracy": {"within": "1%", "goals": ["knee.y", "tip.y"], "max_dofs": 4000},
    }  # fmt: skip
    found = solve(Scene.model_validate(scene)).record["accuracy"]
    assert not found["reached"]
    _, *levels = found["levels"]
    for level in levels:
        tip, knee = (level["goals"][name] for name in ("tip.y", "knee.y"))
        assert abs(tip["corrected"] + 1.42976) < 1.2 * tip["bound"]
        assert abs(knee["corrected"] + 0.25470) < knee["bound"]


def test_round_bodies_have_curved_cells(capsys):
    """Each level is the same body, so the corrected values converge to that of the round one."""
    accuracy = {"within": 0.01, "goals": ["right.force.x"]}
    result = fem_snh.run("stretch", element="Q1P0", cells=6, steps=6, accuracy=accuracy)
    assert "order = 2 in place of 1: cells with curved faces" in capsys.readouterr().out
    found = result.record["accuracy"]
    assert found["reached"] and len(found["levels"]) > 1
    goal = found["levels"][-1]["goals"]["right.force.x"]
    force, _ = exact("stretch")
    assert goal["corrected"] == pytest.approx(force, rel=0.01)
    assert goal["corrected"] == pytest.approx(force, abs=goal["bound"])


def test_limits_end_the_levels(capsys):
    words = "run cook --element Q1P0 --cells 8 --nu 0.3 --accuracy 0.1% --max-dofs 1300"
    keep = ["--set", "kinematics=layer", "--set", "accuracy.keep_element=true"]
    assert main([*words.split(), *keep]) == 1
    output = capsys.readouterr().out.splitlines()
    assert output[-1].startswith("not within 0.1 %: ")
    assert "max_dofs = 1,300: the next level has about" in output[-1]
    assert any(line.startswith("level 1: 4 Q1P0 cells, 54 dofs, ") for line in output)
    assert any(line.startswith("level 2: about ") for line in output)


@mpi
def test_ranks_of_unequal_speed_decide_alike(comm, monkeypatch):
    """A rank that measures more seconds than `max_time` leaves no other one waiting."""
    if comm.rank:
        monkeypatch.setattr(cache, "perf_counter", lambda: 1e6 * perf_counter())
    asked = {"within": 1e-3, "goals": ["energy"], "max_time": 600, "max_dofs": 1000}
    found = solve("twist", comm, cells=2, nu=0.3, steps=1, element="Q1", angle=0.5, accuracy=asked)
    limits = comm.allgather(found.record["accuracy"]["limit"])
    assert len(set(limits)) == 1 and limits[0].startswith("max_dofs = 1,000: ")


@mpi
def test_a_level_that_takes_much_longer_than_it_may_is_given_up(comm, folder, monkeypatch):
    """The level before is the result, and in the folder."""
    monkeypatch.setattr(Levels, "exceeds", lambda *_: "")  # as if its end were expected in time
    accuracy = {"within": 1e-3, "goals": ["energy"], "max_time": 1e-3}
    scene = scenes.load("twist", cells=4, nu=0.3, angle=0.5)
    found = fem_snh.run(scene, comm=comm, out=folder / "run", accuracy=accuracy, progress=False)
    limit = found.record["accuracy"]["limit"]
    assert limit.startswith("level 2: max_time = 0.001 s, of which ") and found.converged
    assert len(found.record["accuracy"]["levels"]) == 1
    stored = json.loads((folder / "run" / "run.json").read_text())
    assert stored["accuracy"]["limit"] == limit and stored["status"] == "converged"
    assert stored["cells"] == found.record["cells"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--accuracy 0", "accuracy.within = 0.0: expected per cent or a fraction, more"),
        ("--accuracy 200%", "more than 0 and less than 1, e.g. '1%' or 0.01"),
        ("--accuracy nan", "accuracy.within = nan: expected per cent"),
        ("--accuracy fine", "accuracy.within = 'fine': expected per cent"),
        ("--accuracy 1% --set accuracy.within=2%", "--accuracy and --set accuracy.within: exp"),
        ("--cells 2 --set cells=3", "--cells and --set cells: expected one of them"),
        ("--max-dofs 9 --set accuracy.max_dofs=8", "--max-dofs and --set accuracy.max_dofs: ex"),
        ("--max-dofs 100", "accuracy: missing key 'within': expected with 'max_dofs'"),
        ("--set accuracy.path=true", "accuracy: missing key 'within': expected with 'path'"),
    ],
)
def test_bad_input(words, message, capsys):
    assert main(["run", "cook", *words.split()]) == 2
    output = capsys.readouterr().err
    assert message in output and output.count("\n") == 1


@mpi
@pytest.mark.parametrize(("nu", "element"), [(0.3, "P2"), (0.49, "P2P0")])
def test_hexahedra_of_a_file_become_tetrahedra(nu, element, comm, folder):
    """The same accuracy is reached as with the mesh of a geometry, which has hexahedra."""
    loaded = scenes.load("twist", nu=nu, angle=0.5, element="Q1P0")
    path = folder / "cube.xdmf"
    meshes.write_xdmf(meshes.generate(comm, "cube", "hexahedron", cells=3), path)
    asked = {"accuracy.within": 0.01, "accuracy.goals": "energy"}
    of_file = solve(loaded.model_copy(update={"mesh": path, "cells": None}), comm=comm, **asked)
    own = solve(loaded, comm=comm, **asked)
    levels = [found.record["accuracy"]["levels"] for found in (of_file, own)]
    assert of_file.record["accuracy"]["reached"] and own.record["accuracy"]["reached"]
    assert [level["element"] for level in levels[0][:2]] == ["Q1P0", element]
    assert levels[0][1]["cells"] == 6 * levels[0][0]["cells"]
    assert levels[1][-1]["element"] in ("Q2", "Q2Q1")
    here, there = (found[-1]["goals"]["energy"] for found in levels)
    assert abs(here["corrected"] - there["corrected"]) <= here["bound"] + there["bound"]


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"accuracy.keep_element": True}, "keep_element is true"),
        ({"static_condensation": True}, "static_condensation = 'true': "),
    ],
)
def test_hexahedra_of_a_file_that_cannot_become_simplices(keys, reason, tmp_path):
    path = tmp_path / "cube.xdmf"
    meshes.write_xdmf(meshes.generate(MPI.COMM_SELF, "cube", "hexahedron", cells=2), path)
    loaded = scenes.load("twist", nu=0.3, element="Q1P0")
    scene = loaded.model_copy(update={"mesh": path, "cells": None})
    keys = {"accuracy.within": 0.01, "accuracy.goals": "energy", **keys}
    found = solve(scene, **keys).record["accuracy"]
    assert not found["reached"] and len(found["levels"]) == 1
    assert found["limit"].startswith(f"cells of a file are refined as simplices, and {reason}")


@pytest.mark.one_debian
def test_the_load_steps_are_followed_on_the_last_mesh(capsys):
    """Its rows are those of a run on that mesh; the goal is that of the level."""
    scene = {"kinematics": "layer", "element": "Q1P0", "cells": 4, "nu": 0.3, "steps": 3}
    asked = {"within": 0.01, "goals": ["corner.y"], "keep_element": True}
    short = fem_snh.run("cook", **scene, accuracy=asked, progress=False)
    whole = fem_snh.run("cook", **scene, accuracy=asked | {"path": True})
    assert "the load steps are followed on the last mesh" in capsys.readouterr().out
    assert [row["load"] for row in short.steps] == [1.0]
    assert [row["load"] for row in whole.steps] == pytest.approx([1 / 3, 2 / 3, 1.0])
    assert whole.record["cells"] == short.record["cells"]
    one, other = (found.record["accuracy"] for found in (short, whole))
    assert len(one["levels"]) == len(other["levels"]) > 1 and other["reached"]
    values = [found["levels"][-1]["goals"]["corner.y"]["value"] for found in (one, other)]
    assert values[1] == pytest.approx(values[0], rel=1e-4)


def test_a_level_that_finds_no_equilibrium_starts_at_rest(monkeypatch, capsys):
    """Also in a scene of one step; the end state before it is replaced by a torn one."""

    def tear(source, target):
        size = target.owned_displacements
        target.x.array[:size] = np.random.default_rng(0).uniform(-40, 40, size)

    monkeypatch.setattr("fem_snh.runs.level_runs.transfer_state", tear)
    found = fem_snh.run(
        "cook", kinematics="layer", element="Q1P0", cells=4, steps=1, petsc={"snes_max_it": 12},
        accuracy={"within": 0.05, "goals": ["corner.y"], "keep_element": True},
    )  # fmt: skip
    assert "the path is followed again" in capsys.readouterr().out
    assert found.record["accuracy"]["reached"] and len(found.record["accuracy"]["levels"]) > 1


@pytest.mark.parametrize(
    ("name", "keys", "element"),
    [
        ("twist", {"element": "Q1P0", "nu": 0.3}, "Q2"),
        ("twist", {"element": "P1", "nu": 0.49}, "P2P0"),
        ("cook", {"element": "Q2Q1", "nu": 0.49}, "P2P1"),
        ("cook", {"element": "Q2Q1", "nu": 0.49, "accuracy.keep_element": True}, "Q2Q1"),
        ("cook", {"element": "P1", "nu": 0.49}, "P2P1"),  # triangles
        ("cook", {"element": "Q1P0", "nu": 0.3}, "P2"),
        ("cook", {"element": "Q1P0", "nu": 0.3, "kinematics": "layer"}, "Q2"),
        ("stretch", {"element": "Q1P0", "nu": 0.49}, "Q2Q1"),  # round
        ("cook", {"element": "Q1P0", "nu": 0.3, "accuracy.keep_element": True}, "Q1P0"),
        ("press", {"element": "Q1", "nu": 0.3}, "Q1"),  # contact
        ("bounce", {"element": "P1", "nu": 0.3}, "P2"),  # in time
        # a stress without an energy
        ("twist", {"material": "filtered_neo_hookean", "element": "Q1", "nu": 0.49}, "Q2"),
        # the pressure of its volume term, in log(J), is found by iterations; of the other, by none
        ("twist", {"material": "neo_hookean", "element": "Q1", "nu": 0.49}, "Q2Q1"),
        ("twist", {"material": "c2_neo_hookean", "element": "Q1", "nu": 0.49}, "Q1P0"),
    ],
)
def test_the_element_of_the_levels(name, keys, element):
    """Degree 2 where larger cells are the same body, and what the features and materials have."""
    scene = scenes.load(name, **{"accuracy.within": 0.01, **keys})
    assert first_scene(scene, Progress(MPI.COMM_SELF, False)).element == element


@pytest.mark.one_debian
def test_the_penalty_of_a_fluid_is_raised():
    """The first part of the penalty is more than was asked for."""
    scene = shell(SYMMETRIC, steps=2)
    (fluid,) = scene.cavity
    asked = Accuracy(goals=["pole.x"], within=0.0004, max_time=60)
    little = fluid.model_copy(update={"volume": fluid.volume / 8})
    update = {"cavity": [little], "accuracy": asked, "cells": 10}
    found = solve(scene.model_copy(update=update)).record["accuracy"]
    assert found["reached"]
    levels = [level["goals"]["pole.x"] for level in found["levels"]]
    for level in levels[1:]:
        assert abs(level["corrected"] - levels[-1]["corrected"]) <= level["bound"]
    assert abs(levels[0]["parts"]["penalty"]) > 0.0004 * levels[0]["value"]


def test_a_crushed_body_that_is_back_at_rest_has_no_relative_errors():
    """Forces within rounding leave displacements of 1e-14 to 1e-10: the limit was 1e-12."""
    found = solve("crush", cells=3, accuracy={"within": 0.05, "max_dofs": 4000})
    accuracy = found.record["accuracy"]
    assert accuracy["reached"] and len(accuracy["levels"]) == 2
    assert all(np.isfinite(goal["bound"]) for goal in accuracy["levels"][-1]["goals"].values())
    energy = solve("crush", cells=3, error=True).estimate.goals["energy"]
    assert energy.value < 1e-20 and energy.is_zero


@mpi
def test_a_body_on_which_a_force_acts_is_not_at_rest():
    """However small it is: zeros that rounding had made were within any accuracy."""
    goals = {}
    for force in (1e-9, 1e-12, 1e-30, 0.0):
        found = solve(sheared(force=force, element="Q1P0"))
        assert is_at_rest(found.problem) == (force == 0.0)
        goals[force] = found.goals["corner.x"]
    assert goals[1e-12]["value"] == pytest.approx(1e-3 * goals[1e-9]["value"], rel=1e-6)
    assert goals[1e-30]["value"] != 0 == goals[0.0]["value"]
    moved = loaded(UP).model_copy(update={"traction": [], "table": []})
    move = scenes.Move(group="top", translate=(1e-12, 0, 0))
    assert not is_at_rest(solve(moved.model_copy(update={"move": [move]})).problem)
