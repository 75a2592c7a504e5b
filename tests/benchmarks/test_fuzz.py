"""The quick share of the fuzzers: ``python -m benchmarks fuzz`` runs the whole."""

from __future__ import annotations

import os
import re
import signal
import sys
from pathlib import Path
from random import Random
from typing import Any

import pytest

from benchmarks import fuzz
from benchmarks.fuzz.family import Family, judge, load_families, run_case

#: Cases of each family: those of meshes and surfaces start a process for each file.
QUICK = {
    "mesh": 8,
    "surface": 10,
    "motion": 40,
    "skeleton": 40,
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
    changed = {"mesh": 1, "surface": 2, "motion": 4, "skeleton": 4, "fit": 2}
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


@pytest.mark.parametrize(
    ("code", "stderr", "kept", "failure"),
    [
        (0, "", False, ""),
        (2, "fem-snh: error: no\n", False, ""),
        (1, "fem-snh: error: no\n", True, ""),
        (1, "fem-snh: error: no\n", False, "exit code 1 without a result"),
        (2, "", False, "exit code 2 with 0 lines on standard error"),
        (2, "warning\nfem-snh: error: no\n", False, "exit code 2 with 2 lines on standard error"),
        (1, "Traceback (most recent call last):\nZeroDivisionError: no\n", True, "traceback: Zero"),
        (0, "Traceback (most recent call last):\nZeroDivisionError: no\n", True, "traceback: Zero"),
        (-signal.SIGSEGV, "", False, "signal SIGSEGV"),
        (None, "", False, "hang"),
        (-signal.SIGXCPU, "", False, "hang"),
        (3, "", False, "exit code 3"),
    ],
)
def test_what_counts_as_a_failure(code: int | None, stderr: str, kept: bool, failure: str) -> None:
    found = judge(code, stderr, kept)
    assert found.startswith(failure) and bool(found) == bool(failure)


def make(random: Random, folder: Path) -> list[str]:
    """A file of the user"""
    (folder / "file").write_bytes(random.randbytes(8))
    return ["file"]


def crash(arguments: list[str]) -> int:
    os.kill(os.getpid(), signal.SIGSEGV)
    return 0


def change(arguments: list[str]) -> int:
    Path(arguments[0]).write_text("changed")
    return 0


def remove(arguments: list[str]) -> int:
    Path(arguments[0]).unlink()
    return 0


@pytest.mark.parametrize(
    ("main", "failure"),
    [
        (crash, "signal SIGSEGV"),
        (change, "file was changed"),
        (remove, "file was removed"),
        (lambda arguments: 1 // 0, "traceback: ZeroDivisionError"),
        (lambda arguments: sys.exit(4), "exit code 70"),
        (lambda arguments: 0, ""),
    ],
)
def test_a_failure_is_noticed(tmp_path: Path, main: Any, failure: str) -> None:
    outcome = run_case("own", Family(make, main), 0, tmp_path)
    assert outcome["failure"].startswith(failure) and bool(outcome["failure"]) == bool(failure)


def test_a_seed_makes_the_same_case(tmp_path: Path) -> None:
    for name, family in load_families().items():
        made = []
        for folder in (tmp_path / f"{name}-a", tmp_path / f"{name}-b"):
            folder.mkdir()
            arguments = family.make(Random(f"{name} 5"), folder)
            files = {path.name: path.read_bytes() for path in folder.iterdir()}
            made.append((arguments, files))
        assert made[0] == made[1] and made[0][1]
