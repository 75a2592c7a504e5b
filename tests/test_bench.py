"""The measurements: rows that say what they should, on problems small enough for a test."""

from __future__ import annotations

import json

import pytest

from fem_snh.errors import BadInput
from fem_snh.studies import bench
from fem_snh.studies.bench import assembly, stretch, twist


def test_assembly_is_faster_than_ffcx() -> None:
    """The issue's limits hold with room to spare, so a busy machine may not break them."""
    for row in assembly.rows(elements="Q1,P1,P2", cells=8, repeat=5):
        assert row["filtered"] > 0.5  # the filter has work to do
        assert row["ratio"] <= row["limit"] and row["ok"]


def test_assembly_of_a_material_without_ufl() -> None:
    (row,) = assembly.rows(elements="Q1", cells=4, material="fixed_corotational", repeat=1)
    assert "ratio" not in row and row["clamp_us"] > 0


def test_twist_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main("twist", {"cells": 4, "hessians": "adaptive"}) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["bench"] == "twist" and row["converged"] and len(row["newton"]) == 2
    assert row["paper"] == twist.PAPER


def test_stretch_has_the_papers_order() -> None:
    rows = {row["material"]: row for row in stretch.rows(elements="P2", cells=4)}
    assert set(rows) == set(stretch.PAPER)
    volume = {name: row["volume_percent"] for name, row in rows.items()}
    assert all(row["ok"] for row in rows.values())
    paper = sorted(rows, key=lambda name: stretch.PAPER[name])
    assert sorted(rows, key=lambda name: volume[name]) == paper
    assert 0 < volume[paper[0]]


def test_every_material_against_the_stable_one() -> None:
    """At most 1.5 times its assembly: 1.13 on a quiet machine, so a busy one may not break it."""
    rows = list(assembly.compare("Q1", 4, 20, ["ogden", "valanis_landel_xu"]))
    assert [row["material"] for row in rows] == ["ogden", "valanis_landel_xu"]
    assert all(row["ok"] and row["filtered"] > 0.4 for row in rows)


def test_mistakes() -> None:
    with pytest.raises(BadInput, match=r"unknown bench 'asembly' .did you mean 'assembly'"):
        bench.main("asembly", {})
    with pytest.raises(BadInput, match="unknown option of bench twist 'cell'"):
        bench.main("twist", {"cell": 3})
