"""Errors of scenes in time: of the mesh and of the time steps, and a required accuracy."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from running import solve
from time_scenes import SWING, in_time

from fem_snh import scenes
from fem_snh.accuracy.levels import LevelRow, Levels
from fem_snh.accuracy.path_errors import bounds_of_small_changes, resolved_penalty, steps_errors
from fem_snh.runs.scene_goals import scene_goals
from fem_snh.runs.setup import set_up
from fem_snh.scenes import (
    Accuracy,
    Geometry,
    Hold,
    MaterialChoice,
    Obstacle,
    Probe,
    Reaction,
    Scene,
    Time,
    Traction,
)
from fem_snh.tables.amplitudes import Amplitude

TIP = [Probe(name="tip", point=(1, 1, 1))]
GOALS = Accuracy(goals=["tip.z"])


def swing(steps, **keys):
    """A cube that falls from rest while its left side is held, for a third of a swing."""
    return in_time({"duration": 0.3, "steps": steps}, probe=TIP, **SWING, **keys)


def tip(result):
    return result.steps[-1]["probes"]["tip"][2]


def goals_without_an_estimate(scene, **keys):
    """Return the values of a scene's goals by name, at the end of its steps."""
    setup = set_up(MPI.COMM_WORLD, scene, **keys)
    assert all(row["converged"] for row in setup.stepper)
    values = {goal.names[0]: goal.bind(setup.problem)()[-1] for goal in scene_goals(setup)}
    setup.destroy()
    return values


@pytest.fixture(scope="module")
def estimated():
    return solve(swing(24, accuracy=GOALS))


@pytest.mark.one_debian
def test_the_error_of_the_time_steps(estimated):
    """Against four times as many steps, whose error is a sixteenth."""
    goal = estimated.goals["tip.z"]
    exact = tip(solve(swing(96)))
    assert goal["value"] == tip(estimated)
    assert 0.7 < goal["parts"]["time steps"] / (exact - goal["value"]) < 1.4


@pytest.mark.one_debian
def test_the_error_of_the_mesh_is_the_difference_to_the_lifted_element(estimated):
    goal = estimated.goals["tip.z"]
    coarse, lifted = (solve(swing(12, element=element)) for element in ("Q1", "Q2Q1"))
    assert goal["parts"]["mesh"] == pytest.approx(tip(lifted) - tip(coarse), rel=1e-6)
    assert goal["error"] == pytest.approx(sum(goal["parts"].values()))
    assert estimated.record["estimate"]["element"] == "Q2Q1"
    coarse, lifted = (tip(solve(swing(6, element=element))) for element in ("Q1", "Q2Q1"))
    known, change = estimated.estimate.goals["tip.z"], goal["parts"]["mesh"] - (lifted - coarse)
    assert known.mesh_bound == pytest.approx(abs(change), rel=1e-6)
    assert known.of_path >= abs(goal["parts"]["mesh"])


PULSE = Amplitude(name="pulse", points=[(0, 0), (1.812, 1), (3.352, 0)])


def pulled_membrane(steps):
    """Cook's membrane after a pulse of traction, in steps that hardly resolve how it swings."""
    time = {"duration": 6.323, "integrator": "backward_euler", "damping": {"stiffness": 0.0581}}
    return in_time(
        time | {"steps": steps}, name="cook", mesh=Geometry(source="cook"),
        kinematics="plane_strain", cells=4, element="Q2", petsc={}, hold=[Hold(group="left")],
        material=MaterialChoice(name="stable_arruda_boyce", E=1.0, nu=0.0, density=48.0**-2),
        traction=[Traction(group="right", vector=(-0.00339, -0.02477, 0), table="pulse")],
        table=[PULSE], reactions=[Reaction("left")], accuracy=Accuracy(goals=["left.moment.z"]),
    )  # fmt: skip


def test_steps_that_hardly_change_a_goal_at_one_instant():
    """The moment was said to be known to 4 %, and has another sign with eight times the steps."""
    goal = solve(pulled_membrane(20)).estimate.goals["left.moment.z"]
    fine = solve(pulled_membrane(160)).estimate.goals["left.moment.z"]
    assert goal.value > 2 and fine.value < -1
    assert abs(goal.error) < 0.1 * abs(goal.value)
    assert abs(fine.value - goal.value) < goal.bound
    assert f"left.moment.z {goal.value:.6g}, error below" in goal.text("left.moment.z")


@pytest.mark.one_debian
@pytest.mark.parametrize(
    ("duration", "steps", "element", "shown"),
    [(1.0, 16, "Q2", "tip.z -3.66931, error below"), (2.0, 128, "Q1", "time steps below 0.069, ")],
)
def test_steps_without_an_order_have_a_bound_and_no_error_of_zero(duration, steps, element, shown):
    """It said "time steps +0", where the steps change the tip by 0.014 and 0.009 m."""
    keys = SWING | {"element": element}
    time = {"duration": duration, "steps": steps}
    found = solve(in_time(time, probe=TIP, accuracy=GOALS, **keys))
    goal = found.estimate.goals["tip.z"]
    assert goal.parts["time steps"] == 0 < goal.steps_bound
    assert shown in goal.text("tip.z")
    assert found.record["goals"]["tip.z"]["bound"] >= abs(goal.error) + goal.steps_bound
    exact = tip(solve(in_time(time | {"steps": 4 * steps}, probe=TIP, **keys)))
    assert 0.005 < abs(exact - goal.value) < goal.steps_bound


def bounce(integrator, friction, steps):
    """A ball that falls by 0.2 m and bounces; with friction it also flies along x."""
    ball = {"cells": 3, "integrator": integrator, "friction": friction, "height": 0.2, "nu": 0.3}
    scene = scenes.load("bounce", **ball, **{"time.steps": steps})
    start = scenes.Start(velocity=(1, 0, 0)) if friction else None
    accuracy = Accuracy(goals=["body.mean.z"])
    return scene.model_copy(update={"start": start, "accuracy": accuracy})


@pytest.mark.parametrize(("integrator", "friction"), [("newmark", 0.3), ("generalized_alpha", 0.0)])
def test_small_changes_that_do_not_decrease_have_a_bound(integrator, friction):
    """The height had no estimate, and lost that of the mesh and of the penalty with it."""
    found = solve(bounce(integrator, friction, 100)).estimate
    goal = found.goals["body.mean.z"]
    (exact,) = goals_without_an_estimate(bounce(integrator, friction, 400)).values()
    assert abs(exact - goal.value) < goal.steps_bound < 0.1 * abs(goal.value)
    assert goal.parts["time steps"] == 0
    assert goal.error == goal.parts["mesh"] + goal.parts["penalty"] != 0
    bounds = goal.steps_bound + goal.mesh_bound + goal.penalty_bound + goal.missed
    parts = goal.of_path + abs(goal.parts["penalty"])
    assert goal.bound == pytest.approx(parts + bounds)
    assert goal.bound >= abs(goal.error) + bounds
    for part in ("error below", "time steps below", "mesh ", "penalty "):
        assert part in goal.text("body.mean.z")
    levels = Levels(0.01)
    levels.add(LevelRow("P1", 1, 8, 81, 1.0, steps=100), found)
    level = levels.rows[0].goals["body.mean.z"]
    assert not levels.rows[0].steps_have_no_order
    assert level.uncertainty > goal.steps_bound


def test_bounds_of_small_changes():
    """Of values 3 + c h of order 1, and of the swing: its last two of three are small by chance."""
    values = [3 + 0.1 * h for h in (1, 2, 4, 8)]
    swing = [-0.7977, -0.8060, -0.7984, -1.5465]
    changes = np.array([[a[i] - a[i + 1] for a in (values, swing)] for i in range(3)])
    bounds = bounds_of_small_changes(changes, np.array([3.0, 0.04]), 2)
    assert bounds == pytest.approx([2 * 0.2, np.inf])
    exact = np.array([3.0, -0.725])
    assert (np.abs(exact - [values[0], swing[0]]) < bounds).all()
    bounds = bounds_of_small_changes(changes, np.array([0.09, 0.3]), 2)
    assert bounds == pytest.approx([np.inf, (1.5465 - 0.7984) / 2])


@pytest.mark.one_debian
def test_a_motion_to_a_required_accuracy():
    """A cantilever that falls; the reference has a fifth of the error of the last level."""
    bar = in_time(
        {"duration": 0.5, "steps": 16}, element="Q1P0", **SWING,
        mesh=Geometry(source="bar", parameters={"length": 2.0, "interface": 1.0}),
        probe=[Probe(name="tip", point=(2, 0.5, 0.5))],
        accuracy=Accuracy(goals=["tip.z"], within=0.0015),
    )  # fmt: skip
    record = solve(bar).record["accuracy"]
    assert record["reached"] and len(record["levels"]) > 1
    last = record["levels"][-1]["goals"]["tip.z"]
    exact = -1.227161  # 64 steps on 3 cells of Q2Q1 across the bar
    assert abs(last["best"] - exact) < 0.0015 * abs(exact)


@pytest.mark.one_debian
def test_the_penalty_of_an_impact():
    """A ball in the middle of its impact: what 16 times the stiffness changes."""
    keys = {"cells": 2, "time.duration": 0.45, "time.steps": 80}
    update = {"probe": [Probe(name="centre", point=(0, 0, 0))], "error": True}
    update["accuracy"] = Accuracy(goals=["centre.z"])
    scene = scenes.load("bounce", **keys).model_copy(update=update)
    goal = solve(scene).estimate.goals["centre.z"]
    (stiff,) = goals_without_an_estimate(scene, stiffer=16.0).values()
    assert abs(stiff - goal.value) > 0.04 * abs(goal.value)
    assert goal.parts["penalty"] / (stiff - goal.value) == pytest.approx(16 / 15, rel=0.15)


def pulled_tube(cells):
    """A tube whose bonded outside is at rest, after a pull along its inside."""
    return Scene(
        name="tube", kinematics="axisymmetric", cells=cells, element="P2P1",
        mesh=Geometry(source="tube", parameters={"section": 1, "outer": 1.5, "length": 1.0}),
        material=MaterialChoice(name="neo_hookean", E=1.0, nu=0.48, density=1.0),
        hold=[Hold(group="outer")], traction=[Traction(group="inner", vector=(0, -0.1, 0))],
        time=Time(duration=2.0, steps=32, damping={"stiffness": 0.2}),
        probe=[Probe(name="tip", point=(1, 0.5, 0))], accuracy=Accuracy(goals=["tip.y"]),
    )  # fmt: skip


def test_the_decay_at_a_bonded_edge_counts_in_time_too():
    """Without it the estimate was half of the error."""
    found = solve(pulled_tube(2)).estimate
    goal = found.goals["tip.y"]
    fine = solve(pulled_tube(8).model_copy(update={"accuracy": None}))
    error = fine.steps[-1]["probes"]["tip"][1] - goal.value
    assert found.saturation > 1.5
    assert 0.7 < goal.parts["mesh"] / error < 1.4


def thrown_cylinder(steps):
    """A cylinder that is thrown at a plane, as a body of revolution."""
    plane = {"plane": {"point": (0, -0.0552, 0), "normal": (0, 1, 0)}}
    time = {"duration": 1.3568, "integrator": "generalized_alpha", "damping": {"stiffness": 0.0833}}
    return Scene(
        name="cylinder", mesh=Geometry(source="cylinder"), kinematics="axisymmetric", cells=4,
        element="Q2Q1", time=Time(steps=steps, **time),
        obstacle=[Obstacle(name="ground", shape=plane)],
        material=MaterialChoice(name="neo_hookean", E=1.0, nu=0.45, density=1.0),
        start=scenes.Start(velocity=(0, -0.1479, 0)),
        accuracy=Accuracy(goals=["ground.force.y", "body.mean.x"]),
    )  # fmt: skip


def test_penalties_that_yield_too_much_for_an_estimate_by_softer_ones():
    """The force of a plane was corrected by 12 % in the wrong direction, with a bound of 9 %."""
    goals = solve(thrown_cylinder(20)).estimate.goals
    for name, exact in goals_without_an_estimate(thrown_cylinder(160), stiffer=16.0).items():
        known = goals[name]
        assert known.penalty_bound > 0
        assert abs(exact - known.value) < known.bound
        assert abs(exact - known.corrected) < known.bound


def error_and_bound(values, orders):
    """Return those of the last of three values, each with half of the step before."""
    change, before = (np.array([values[i] - values[i - 1]]) for i in (2, 1))
    (error,), (bound,) = steps_errors(change, before, 2.0, orders)
    return error, bound


@pytest.mark.parametrize("order", [1, 2])
def test_errors_of_steps_that_converge(order):
    """Values 3 + c h^p with h, 2 h and 4 h: the error is found, and within the bound."""
    values = [3 + 0.1 * (k / 4) ** order for k in (4, 2, 1)]
    error, bound = error_and_bound(values, (1, 2))
    assert error == pytest.approx(3 - values[2])
    assert abs(error) <= bound * (1 + 1e-9)


def test_a_bound_of_steps_whose_last_change_is_small_by_chance():
    """The swing with 5, 10, 20 steps of Q1P0, and 160 as the reference."""
    values = [-1.3653462, -1.2334404, -1.2080655]
    _, bound = error_and_bound(values, (2, 2))
    assert abs(-1.1804332 - values[2]) < bound


def test_a_bound_of_steps_whose_changes_have_different_signs():
    """A cylinder whose side is moved by a table with kinks: 6, 12 and 24 steps, and 96."""
    values = [0.0027107, 0.0033639, 0.0032717]
    _, bound = error_and_bound(values, (2, 2))
    before = abs(values[1] - values[0])
    assert before / 4 < abs(0.0035208 - values[2]) < bound == before / 2


def test_the_error_of_a_penalty_that_time_steps_do_not_resolve():
    """The bounce with 4 times the stiffness: by 16 times it the estimate has the wrong sign."""
    (error,), (missed,) = resolved_penalty(np.array([0.0037]), np.array([-0.0042]))
    assert error == -0.0042
    assert missed == pytest.approx(2 * (0.0037 + 0.0042))
    assert resolved_penalty(np.array([0.038]), np.array([0.030])) == (0.038, 0)
