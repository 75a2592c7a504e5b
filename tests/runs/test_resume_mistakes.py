"""What may be resumed and what may not; the parts of a checkpoint."""

from __future__ import annotations

import numpy as np
import pytest
from interrupted_runs import STRETCH, cut, record, solve

import fem_snh
from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.runs.output import nodal_values

mpi = pytest.mark.mpi


@pytest.mark.one_debian
@mpi
def test_a_finished_run_is_left_as_it_is(comm, folder):
    whole = solve("stretch", out=folder, **STRETCH)
    comm.barrier()
    files = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
    again = solve("stretch", out=folder, resume=True, **STRETCH)
    assert again.converged and again.steps == record(folder)["steps"]
    assert np.array_equal(again.u.x.array, whole.u.x.array)
    assert {file: file.stat().st_mtime_ns for file in folder.iterdir()} == files
    comm.barrier()


@mpi
def test_a_finished_run_gets_what_was_not_asked_for_before(comm, folder, capsys):
    """It said "nothing to do"."""
    whole = solve("stretch", out=folder, **STRETCH)
    keys = {"stability": True, "fields": ["von_mises"]}
    scene = scenes.load("stretch", **STRETCH).model_copy(update=keys)
    comm.barrier()
    again = fem_snh.run(scene, out=folder, resume=True, comm=comm)
    expected = "finished already: computing of its last state: stability; fields von_mises"
    assert comm.rank or expected in capsys.readouterr().out
    *before, last = [row.get("stability") for row in again.steps]
    assert last == "stable" and not any(before)
    assert record(folder)["steps"] == again.steps and again.record["fields"] == ["von_mises"]
    assert np.array_equal(again.u.x.array, whole.u.x.array)
    comm.barrier()
    fem_snh.run(scene, out=folder, resume=True, comm=comm)
    assert comm.rank or "finished already: nothing to do" in capsys.readouterr().out
    comm.barrier()


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize(
    "other, key",
    [
        ({"nu": 0.4}, r"material\.nu = 0\.4: expected 0\.3"),
        ({"E": 2.0}, r"material\.E = 2\.0: expected 1\.0"),
        ({"cells": 4}, "cells = 4: expected 3"),
        ({"element": "P1"}, 'element = "P1": expected "Q1"'),
        ({"steps": 7}, "steps = 7"),
        ({"material.barrier": True}, r"material\.barrier = true: expected no value"),
    ],
)
def test_another_scene_is_refused_by_its_key(comm, folder, other, key):
    with cut(1):
        solve("stretch", out=folder, **STRETCH)
    with pytest.raises(BadInput, match="cannot resume .*: " + key):
        solve("stretch", out=folder, resume=True, **STRETCH | other)
    comm.barrier()


@mpi
def test_without_a_checkpoint_it_says_what_to_do(comm, folder):
    with pytest.raises(BadInput, match=r"there is no folder .* start without --resume"):
        solve("stretch", out=folder / "none", resume=True)
    assert not (folder / "none").exists()
    with pytest.raises(BadInput, match=r"has no checkpoint\.npz .* start without --resume$"):
        solve("stretch", out=folder, resume=True)
    if comm.rank == 0:
        (folder / "run.json").write_text("{}")
    comm.barrier()
    with pytest.raises(BadInput, match="start without --resume, with --overwrite"):
        solve("stretch", out=folder, resume=True)
    with pytest.raises(BadInput, match="without --overwrite"):
        solve("stretch", out=folder, resume=True, overwrite=True)
    with pytest.raises(BadInput, match="--resume: expected with --out"):
        solve("stretch", resume=True)


def test_nodes_are_matched_by_coordinates():
    rng = np.random.default_rng(0)
    nodes = rng.uniform(size=(200, 3))
    order = rng.permutation(200)
    assert np.array_equal(nodal_values.match_nodes(nodes[order] + 1e-13, nodes), order)
    with pytest.raises(BadInput, match="another mesh: it has 199 nodes, the checkpoint 200"):
        nodal_values.match_nodes(nodes[1:], nodes)
    with pytest.raises(BadInput, match="another mesh: 200 of its 200 nodes are not"):
        nodal_values.match_nodes(nodes[order] + 1e-3, nodes)
    nodes[1] = nodes[0]
    assert np.array_equal(nodal_values.match_nodes(nodes, nodes), np.arange(200))
    with pytest.raises(BadInput, match="some nodes have the same coordinates"):
        nodal_values.match_nodes(nodes[order], nodes)


@pytest.mark.one_debian
def test_levels_are_not_resumed_in_a_folder_of_other_files(tmp_path):
    """Without a run in it, they would begin among files that are none of theirs."""
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BadInput, match=r"holds files of no run \(notes.txt\)"):
        fem_snh.run("twist", cells=2, accuracy={"within": 0.2}, out=tmp_path, resume=True)
    assert [path.name for path in tmp_path.iterdir() if path.name[0] != "."] == ["notes.txt"]


@pytest.mark.one_debian
def test_levels_begin_again_after_a_run_that_was_killed_before_its_record(tmp_path):
    """Its fields are written before run.json."""
    (tmp_path / "fields.pvd").write_text("")
    accuracy = {"goals": ["energy"], "within": 0.2}
    result = fem_snh.run("twist", cells=2, accuracy=accuracy, out=tmp_path, resume=True)
    assert result.converged and (tmp_path / "levels.npz").exists()
