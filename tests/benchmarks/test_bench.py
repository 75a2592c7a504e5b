"""The measurements: rows that say what they should, on problems small enough for a test."""

from __future__ import annotations

import ast
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from paths import ROOT

import benchmarks
from benchmarks import assembly, effectivity, mutations, twist
from fem_snh.studies.tasks import environment

pytestmark = pytest.mark.one_debian


def test_assembly_is_faster_than_ffcx() -> None:
    """Within three times the benchmark's limits, so that a busy machine does not break them."""
    for row in assembly.rows(elements="Q1,P1,P2", cells=8, repeat=5):
        assert row["filtered"] > 0.5  # the filter has work to do
        assert row["ratio"] <= 3 * row["limit"]


def test_twist_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main("twist", {"cells": 4, "hessians": "adaptive"}) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["bench"] == "twist" and row["converged"] and len(row["newton"]) == 2
    assert row["paper"] == twist.PAPER


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_measurement_that_is_ended_ends_its_runs(number, tmp_path) -> None:
    """They have a session of their own, which the signal does not reach."""
    words = "stretch_times --cells 30 --ways ours --ranks 1".split()
    command, here = [sys.executable, "-m", "benchmarks", *words], environment()
    here["TMPDIR"] = str(tmp_path)  # where it puts the run's folder, so that we know the run
    running = subprocess.Popen(command, env=here, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    late = time.monotonic() + 60
    while not list(tmp_path.glob("*/out")) and time.monotonic() < late:
        time.sleep(0.05)
    assert (runs := _naming(str(tmp_path)))
    running.send_signal(number)
    running.communicate(timeout=60)
    assert running.returncode == 130
    assert not set(runs) & set(_naming(str(tmp_path)))


def _naming(text: str) -> list[str]:
    """Processes with this text in their arguments."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if text in path.read_text():
                found.append(path.parent.name)
        except OSError:
            continue  # it has just ended
    return found


def test_mutations_change_one_line_and_can_be_read() -> None:
    path = ROOT / "fem_snh" / "records" / "units.py"
    found = list(mutations.mutations(path))
    assert {m.kind for m in found} == {"sign", "factor", "index", "comparison"}
    source = path.read_bytes()
    for mutation in found:
        mutated = ast.unparse(ast.parse(mutations.apply(mutation, source)))
        assert mutated != ast.unparse(ast.parse(source)), mutation


def test_measured_effectivities_of_a_random_scene() -> None:
    *rows, last = effectivity.rows(families="plane", first=7000, count=1, within=1e-3)
    assert rows and last["summary"] == len(rows)
    assert last["all"]["beyond"] == 0
    assert all(0.5 < row["effectivity"] < 1.6 for row in rows)
