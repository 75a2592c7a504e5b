"""Goals where they are largest, or at a named load, of runs whose loads return."""

from __future__ import annotations

import pytest
from contact_scenes import slide
from running import record, solve
from test_error_estimate import sheared

from fem_snh.scenes import Accuracy, Amplitude, Traction

mpi = pytest.mark.mpi


def loaded(points, steps=4, **keys):
    """A cube that is sheared by a load with a table; its goals by default, or those of keys."""
    ramp, load = Amplitude(name="ramp", points=points), Traction(group="top", table="ramp", **TOP)
    scene = sheared(element="Q1P0", steps=steps)
    return scene.model_copy(update={"table": [ramp], "traction": [load], **keys})


#: The load returns to zero, or does not.
BACK = [(0, 0), (0.5, 1), (1, 0)]
UP = [(0, 0), (1, 1)]
TOP = {"vector": (0.05, 0, 0)}


@mpi
def test_a_load_that_returns_has_the_errors_of_its_peak(folder, comm, capsys):
    """They are those of a run that ends there, in the record and in the row of that load."""
    there = solve(loaded(UP, steps=2))
    back = solve(loaded(BACK), out=folder)
    assert back.goals.keys() == there.goals.keys()
    for name, goal in back.goals.items():
        assert goal.pop("at") == 0.5, name
        for key, value in there.goals[name].items():
            expected = None if value is None else pytest.approx(value, rel=1e-4, abs=1e-9)
            assert goal[key] == expected, (name, key)
    assert abs(there.goals["corner.x"]["value"]) > 0.1
    assert abs(back.u.x.array).max() < 1e-6
    if comm.rank == 0:
        rows = {row["load"]: row.get("goals", {}) for row in record(folder)["steps"]}
        assert rows[0.5].keys() == rows[1.0].keys() == back.goals.keys()
        assert max(map(abs, rows[1.0].values())) < 1e-6 or rows[1.0].pop("volume") == 1


@mpi
def test_an_accuracy_is_that_of_the_largest_value(comm, capsys):
    """The unloaded end was within any accuracy on the first level: the peak is not."""
    asked = Accuracy(within=0.01, goals=["corner.x"], keep_element=True)
    scenes_ = loaded(UP, steps=2, accuracy=asked), loaded(BACK, accuracy=asked)
    there, back = (solve(scene).record["accuracy"] for scene in scenes_)
    assert back["at"] == {"corner.x": 0.5} and "at" not in there
    assert len(back["levels"]) > 1 and back["reached"]
    for one, other in zip(there["levels"], back["levels"], strict=False):
        assert one["cells"] == other["cells"]
        expected = pytest.approx(one["goals"]["corner.x"]["value"], rel=1e-5)
        assert other["goals"]["corner.x"]["value"] == expected


def test_a_path_with_friction_is_not_judged_by_its_end():
    """Its default goals are where they are largest, along the paths of all estimates."""
    back = {"table": [Amplitude(name="ramp", points=BACK)]}
    scene = slide().model_copy(update={"accuracy": Accuracy(within=0.5)})
    plate = scene.obstacle[0].model_copy(update={"table": "ramp"})
    scene = scene.model_copy(update=back | {"obstacle": [plate]})
    found = solve(scene)
    accuracy = found.record["accuracy"]
    assert accuracy["reached"]
    name = "plate.force.x"
    goal, at = found.estimate.goals[name], found.estimate.loads[name]
    forces = {
        row["load"]: row["obstacles"]["plate"]["force"][0]
        for row in found.steps
        if row["converged"]
    }
    assert 0 < at < 1 and goal.value == pytest.approx(forces[at])
    assert abs(goal.value) > 2 * abs(forces[1.0])
