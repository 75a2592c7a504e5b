"""The table [[contact]] of a scene: a run's rows, mistakes, resuming."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mpi4py import MPI

import pytest
from interrupted_runs import record, solve

from benchmarks import plates
from fem_snh import scenes

#: Two blocks, the upper one wider: it bulges over the lower one.
BLOCKS: dict[str, Any] = {
    "name": "blocks",
    "mesh": {"source": "two_blocks", "parameters": {"upper_width": 1.4, "shift": -0.2}},
    "cells": 2,
    "element": "Q1",
    "steps": 2,
    "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.49},
    "hold": [{"group": "bottom"}],
    "move": [{"group": "top", "translate": [0.0, 0.0, -0.2]}],
    "contact": [{"groups": ["upper_bottom", "lower_top"], "method": "augmented_lagrangian"}],
    "reactions": ["bottom", "top"],
}
SCENE = scenes.validate(BLOCKS, "blocks")
mpi = pytest.mark.mpi


@pytest.mark.one_debian("ranks")
@mpi
def test_rows(folder: Path) -> None:
    """The force is that on the supports."""
    solve(SCENE, out=folder)
    MPI.COMM_WORLD.barrier()
    whole = record(folder)
    assert whole["converged"] and whole["terms"] == ["elastic", "contact"]
    for row in whole["steps"]:
        contact = row["contacts"]["upper_bottom/lower_top"]
        assert contact["force"][2] == pytest.approx(row["reactions"]["bottom"][2], rel=1e-5)
        assert contact["force"][2] == pytest.approx(-row["reactions"]["top"][2], rel=1e-5)
        assert contact["force"][2] > 0 and contact["contacts"] > 0 and row["solves"] > 1
        # A thousandth of a cell's height.
        assert contact["penetration"] <= 0.5e-3 and contact["stiffness"] == pytest.approx(20.0)
    header = (folder / "steps.csv").read_text().splitlines()[0].split(",")
    assert {"upper_bottom/lower_top.force.z", "solves"} <= {*header}


@pytest.mark.one_debian
def test_thin_plates_collide() -> None:
    """A plate falls on another one, eight times as wide as thick; whole surfaces may touch."""
    scene = plates.plates("Q1", "bdf2", "penalty", cells=3, steps=16)
    row = plates.measure(scene)
    assert row["ok"] and row["steps_in_contact"] >= 8
