"""Faults injected into real runs: they fail cleanly, keep their results and can be resumed."""

from __future__ import annotations

import math

import pytest

from benchmarks.faults import FAULTS, trial

pytestmark = pytest.mark.one_debian

#: The faults are in step 4 of 30; the first 8 steps, in a run of their own.
SCENE = ("stretch", "--cells=6", "--steps=8", "--set=stretch=1.27", trial.FIELDS)


@pytest.mark.parametrize("name", FAULTS)
def test_a_disturbed_run_fails_cleanly_and_can_be_resumed(tmp_path, monkeypatch, name):
    monkeypatch.setattr(trial, "SCENE", SCENE)
    row = FAULTS[name](tmp_path)
    assert row["ok"], row
    assert row["status"] and row["newton"] > 0 and row["linear"] > row["newton"]
    assert row["seconds"] > 0 and 0 <= row["difference"] < 1e-9 and math.isfinite(row["difference"])
