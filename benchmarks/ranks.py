"""The same runs on 1 and 2 ranks with Jacobi: equal energies (1e-9) and Newton iterations."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks import Row
from fem_snh.errors import BadInput
from fem_snh.studies.processes import environment, program


def rows(cells: int = 15) -> Iterator[Row]:
    """Yield one row per scene and element."""
    for scene, element, number in (
        ("twist", "Q1", cells),
        ("stretch", "Q1", cells - cells % 2),
        ("stretch", "P2", max(cells // 2, 3)),
    ):
        with tempfile.TemporaryDirectory() as folder:
            one, two = (_run(scene, element, number, n, Path(folder, str(n))) for n in (1, 2))
        pairs = list(zip(one["steps"], two["steps"], strict=True))
        difference = max(abs(a["energy"] - b["energy"]) / abs(a["energy"]) for a, b in pairs)
        newton = [[step["newton"] for step in run["steps"]] for run in (one, two)]
        yield {
            "scene": scene,
            "element": element,
            "cells": one["cells"],
            "newton": newton[0],
            "newton_2_ranks": newton[1],
            "energy_difference": difference,
            "seconds": [run["seconds"]["total"] for run in (one, two)],
            "ok": difference <= 1e-9 and newton[0] == newton[1],
        }


def _run(scene: str, element: str, cells: int, ranks: int, out: Path) -> dict:
    """Return the record (run.json) of a run in processes of its own."""
    arguments = f"run {scene} --element {element} --cells {cells} --quiet --out {out}".split()
    arguments += ["--", "-pc_type", "jacobi"]  # independent of the partition, unlike SSOR
    done = subprocess.run(
        [*program(ranks), *arguments], env=environment(), capture_output=True, text=True
    )
    if done.returncode:
        raise BadInput(
            f"benchmark ranks: {scene} on {ranks} ranks failed: {done.stderr.strip()[-300:]}"
        )
    record: dict = json.loads((out / "run.json").read_text())
    return record
