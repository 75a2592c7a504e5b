"""Faults that happen to real runs: they end well, keep what they have, and can be resumed."""

from __future__ import annotations

import math

import pytest

from fem_snh.studies.extremes.faults import FAULTS


@pytest.mark.parametrize("name", FAULTS)
def test_a_run_ends_well_and_can_be_resumed(tmp_path, name):
    row = FAULTS[name](tmp_path)
    assert row["holds"], row
    assert row["status"] and row["newton"] > 0 and row["linear"] > row["newton"]
    assert row["seconds"] > 0 and 0 <= row["difference"] < 1e-9 and math.isfinite(row["difference"])
