"""Runs to an accuracy that are killed: the last finished level stays, and the next one follows."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from interrupted_runs import CutOff
from running import record, solve

from fem_snh.cli import main
from fem_snh.records.run_files import LEVELS, NEXT_LEVEL
from fem_snh.runs.level_runs import _LevelRuns
from fem_snh.runs.recorder import Recorder

mpi = pytest.mark.mpi

#: Three levels of triangles, meshed again where the error is.
KEYS = {"kinematics": "plane_strain", "nu": 0.45, "cells": 4, "element": "Q1P0", "steps": 2}
KEYS |= {"accuracy.within": 0.0008, "accuracy.goals": "corner.y,right.mean.y"}
#: The moments at which a run is killed: a method, the number of the call, and the finished levels.
MOMENTS = {
    "an estimate": (Recorder, "add_estimate", 3, 2),
    "the first step": (Recorder, "add_step", 1, 0),
    "the end of the first level": (_LevelRuns, "_store", 1, 0),
    "the next level": (_LevelRuns, "_prepare_next", 2, 2),
    "its first step": (Recorder, "add_step", 4, 2),
    "its end": (_LevelRuns, "_store", 3, 2),
}


@contextmanager
def killed_before(owner, name, number):
    """End the run in this ``with`` block before a call of a method."""
    method, left = getattr(owner, name), [number]

    def counted(self, *args):
        left[0] -= 1
        if not left[0]:
            raise CutOff
        return method(self, *args)

    setattr(owner, name, counted)
    try:
        yield
    except CutOff:
        pass
    finally:
        setattr(owner, name, method)
    assert left[0] <= 0


def levels_of(record):
    """The levels without their seconds."""
    levels = record["accuracy"]["levels"]
    return [{key: value for key, value in level.items() if key != "seconds"} for level in levels]


def same(found, expected, comm):
    """Whether records agree: bit for bit on one rank, up to the order of sums on several."""
    if isinstance(expected, dict):
        return found.keys() == expected.keys() and same(
            [*found.values()], [*expected.values()], comm
        )
    if isinstance(expected, list):
        pairs = zip(found, expected, strict=True)
        return len(found) == len(expected) and all(same(*pair, comm) for pair in pairs)
    if isinstance(expected, float) and comm.size > 1:
        return found == pytest.approx(expected, rel=1e-9)
    return found == expected


@pytest.fixture(scope="module")
def whole():
    """The run that nothing interrupts."""
    return solve("cook", **KEYS)


@mpi
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_run_keeps_its_last_level_and_goes_on_after_it(folder, comm, whole, moment):
    out = folder
    *call, finished = MOMENTS[moment]
    with killed_before(*call):
        solve("cook", out=out, **KEYS)
    expected = levels_of(whole.record)
    assert len(expected) == 3
    if finished:
        found = record(out)
        assert found["converged"] and same(levels_of(found), expected[:finished], comm)
        assert found["dofs"] == expected[finished - 1]["dofs"] and found["goals"]
        assert (out / "fields.pvd").exists() and (out / LEVELS).exists()
    comm.barrier()
    resumed = solve("cook", out=out, resume=True, **KEYS)
    assert same(levels_of(resumed.record), expected, comm)
    assert resumed.record["accuracy"]["reached"]
    assert same(record(out)["goals"], whole.record["goals"], comm)
    assert not (out / NEXT_LEVEL).exists()
    comm.barrier()


def test_a_level_that_was_being_taken_is_taken_at_the_next_start(tmp_path, monkeypatch, whole):
    """Of the files of a level some are in the folder, and the rest in its own."""
    out, replace, left = tmp_path / "run", type(tmp_path).replace, [4]

    def counted(self, target):
        if self.parent.name == NEXT_LEVEL and not self.name.startswith("."):
            left[0] -= 1
            if not left[0]:
                raise CutOff
        return replace(self, target)

    with monkeypatch.context() as patched, pytest.raises(CutOff):
        patched.setattr(type(tmp_path), "replace", counted)
        solve("cook", out=out, **KEYS)
    assert (out / NEXT_LEVEL / LEVELS).exists()
    resumed = solve("cook", out=out, resume=True, **KEYS)
    assert levels_of(resumed.record) == levels_of(whole.record)


def test_other_runs_are_not_continued(tmp_path, capsys):
    """Neither one without levels, nor one of other goals."""
    plain, levels = tmp_path / "plain", tmp_path / "levels"
    solve("cook", out=plain, **{k: v for k, v in KEYS.items() if not k.startswith("acc")})
    words = ["run", "cook", *(f"--set={key}={value}" for key, value in KEYS.items())]
    assert main([*words, "--out", str(plain), "--resume"]) == 2
    assert "accuracy.within = 0.0008: expected no value, as before" in capsys.readouterr().err
    assert record(plain)["converged"]
    solve("cook", out=levels, **KEYS | {"accuracy.max_dofs": 1})
    assert record(levels)["accuracy"]["limit"].startswith("max_dofs = 1")
    assert main([*words, "--set=accuracy.goals=volume", "--out", str(levels), "--resume"]) == 2
    assert 'accuracy.goals = ["volume"]: expected ["corner.y"' in capsys.readouterr().err
    without = [word for word in words if not word.startswith("--set=accuracy")]
    assert main([*without, "--out", str(levels), "--resume"]) == 2
    assert "it holds levels of a run to an accuracy: expected --accuracy" in capsys.readouterr().err
    (levels / LEVELS).write_bytes(b"PK")
    assert main([*words, "--out", str(levels), "--resume"]) == 2
    assert "levels.npz cannot be read" in capsys.readouterr().err
