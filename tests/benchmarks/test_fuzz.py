"""The quick share of the fuzzers: ``python -m benchmarks fuzz`` runs the whole."""

from __future__ import annotations

import re
from pathlib import Path
from random import Random
from typing import Any

import pytest

from benchmarks import fuzz
from benchmarks.fuzz.family import Family, load_families, run_case

#: Cases of each family: those of meshes and surfaces start a process for each file.
QUICK = {
    "mesh": 8,
    "surface": 10,
    "motion": 40,
    "fit": 15,
    "scene": 80,
    "scene_run": 6,
    "command": 12,
    "ranks": 1,
}


@pytest.mark.parametrize("family", load_families())
def test_input_has_the_known_answer_or_ends_well(family: str) -> None:
    """At least half of the cases are valid: their numbers are compared."""
    (row,) = fuzz.rows(only=family, count=QUICK[family])
    assert row["ok"], row["failures"]
    assert row["valid"] >= 0.5 and row["cases"] == QUICK[family]


def test_a_wrong_number_is_a_failure(tmp_path: Path) -> None:
    """Of the first whole file of each family that knows its answer, which is then changed."""
    changed = {"mesh": 1, "surface": 2, "motion": 4, "fit": 2}
    for name, place in changed.items():
        family = load_families()[name]

        def make(random: Random, folder: Path, family: Family = family, at: int = place) -> Any:
            arguments = family.make(random, folder)
            arguments[at] = re.sub(r"[1-9]", "7", arguments[at])
            return arguments

        seeds = (s for s in range(20) if "whole" in family.make(Random(f"{name} {s}"), tmp_path))
        outcome = run_case(name, Family(make, family.main), next(seeds), tmp_path)
        assert outcome["failure"].startswith("traceback: AssertionError"), outcome


# --- the judge ------------------------------------------------------------------------------------


def make(random: Random, folder: Path) -> list[str]:
    """A file of the user"""
    (folder / "file").write_bytes(random.randbytes(8))
    return ["file"]


def test_a_seed_makes_the_same_case(tmp_path: Path) -> None:
    for name, family in load_families().items():
        made = []
        for folder in (tmp_path / f"{name}-a", tmp_path / f"{name}-b"):
            folder.mkdir()
            arguments = family.make(Random(f"{name} 5"), folder)
            files = {path.name: path.read_bytes() for path in folder.iterdir()}
            made.append((arguments, files))
        assert made[0] == made[1] and made[0][1]
