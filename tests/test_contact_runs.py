"""Runs of scenes with obstacles: rows, fields, groups and mistakes."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import PRESS
from contact_scenes import slide
from running import record, solve

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.render.fields import written_fields


@pytest.mark.mpi
def test_a_plate_presses_and_rubs(comm, tmp_path):
    """The force on the block is that on its fixed side; friction is at most 0.3 of the pressure."""
    folder = comm.bcast(tmp_path)
    scene = slide().model_copy(update={"reactions": ["bottom"]})
    result = solve(scene, comm=comm, out=folder)
    assert result.converged and result.record["terms"] == ["elastic", "obstacle"]
    steps = record(folder)["steps"]
    for step in steps:
        plate = step["obstacles"]["plate"]
        np.testing.assert_allclose(
            plate["force"], -np.array(step["reactions"]["bottom"]), atol=1e-9
        )
        x, y, z = plate["force"]
        assert z < 0 and 0 < np.hypot(x, y) <= 0.3 * abs(z) * (1 + 1e-3)
        assert 0 < plate["penetration"] < 0.01 and plate["contacts"] == 16
    assert (
        -steps[-1]["obstacles"]["plate"]["force"][2] > -steps[0]["obstacles"]["plate"]["force"][2]
    )
    assert {"contact_pressure", "gap"} <= set(written_fields(folder / "fields.pvd"))


@pytest.mark.parametrize("group, contacts", [("top", 16), ("left", 0)])
def test_a_group_of_the_surface(comm, group, contacts):
    result = solve(slide(group=group), comm=comm)
    assert result.record["steps"][-1]["obstacles"]["plate"]["contacts"] == contacts


def test_a_tolerance_is_relative_to_the_body(comm):
    plate = {"method": "augmented_lagrangian", "tolerance": 1e-6, "friction": 0.0}
    found = solve(slide(**plate), comm=comm).record["steps"][-1]["obstacles"]["plate"]
    assert found["penetration"] <= 1e-6 and 1 < found["solves"] < 10 and "sliding" not in found


def test_mistakes(comm):
    with pytest.raises(BadInput, match=r"obstacle.group = 'corner_000': expected a surface, not a"):
        solve(slide(group="corner_000"), comm=comm)
    with pytest.raises(BadInput, match="no physical group 'lid' in the mesh"):
        solve(slide(group="lid"), comm=comm)
    with pytest.raises(BadInput, match=r"fields = 'gap': expected another field, as the scene has"):
        scenes.load(PRESS, fields=["gap"])


@pytest.mark.parametrize("name, options", [("hertz", {"cells": 2}), ("bounce", {"cells": 2})])
def test_scenes(comm, name, options):
    """They run; a ball that falls for 0.3 s touches the ground, and an indented one has a force."""
    if name == "bounce":
        options |= {"time.duration": 0.4, "steps": 12, "integrator": "bdf2"}
    rows = solve(name, comm=comm, **options).record["steps"]
    (obstacle,) = rows[-1]["obstacles"].values()
    assert rows[-1]["converged"] and obstacle["force"][2] > 0 and obstacle["contacts"] > 0


def test_multipliers_settle_in_an_impact():
    """Three multipliers on each facet of P1 are more than it can follow: the stiffness grows."""
    multipliers = {"obstacle.0.method": "augmented_lagrangian", "obstacle.0.tolerance": 1e-4}
    result = solve("bounce", cells=3, **{"time.steps": 24, "time.duration": 0.5} | multipliers)
    assert result.converged and len(result.steps) == 24  # no step is halved
    touching = [step for step in result.steps if step["obstacles"]["ground"]["contacts"]]
    assert len(touching) >= 8
    size = result.problem.length
    for step in touching:
        assert step["obstacles"]["ground"]["penetration"] <= 1e-4 * size
        assert step["newton"] <= 40
