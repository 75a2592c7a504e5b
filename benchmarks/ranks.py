"""The same runs on 1, 2 and 3 ranks: equal energies and Newton iterations, and equal bits twice."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks import Row, split_list
from fem_snh.errors import BadInput
from fem_snh.studies.tasks import environment, program

#: Largest relative difference of the energies of a step.
LIMIT = 1e-9
#: The preconditioner that is independent of the partition, unlike SSOR: iterations are compared
#: with it.
_JACOBI = ("-pc_type", "jacobi")


def rows(cells: int = 15, ranks: str = "1,2,3") -> Iterator[Row]:
    """Yield one row per scene, element and preconditioner.

    Parameters
    ----------
    cells : int
        Cells along an edge for Q1, half as many for the others.
    ranks : comma list
        Numbers of ranks; each is compared with the first, and the last one runs twice.

    Yields
    ------
    dict
        ``same_bits``: whether all steps of the two runs on the same number of ranks have the same
        energy, residual and iterations, to the last bit.
    """
    counts = [int(n) for n in split_list(ranks)]
    half = max(cells // 2, 3)
    for scene, element, number, options in (
        ("twist", "Q1", cells, _JACOBI),
        ("stretch", "Q1", cells - cells % 2, _JACOBI),
        ("stretch", "P2", half, _JACOBI),
        ("twist", "Q1", cells, ()),
        ("stretch", "P2", half, ()),
        ("stretch", "Q2Q1", half, ()),
    ):
        runs = [_run(scene, element, number, n, options) for n in counts]
        again = _run(scene, element, number, counts[-1], options)
        first = [step["energy"] for step in runs[0]["steps"]]
        differences = [
            max(abs(step["energy"] / e - 1) for step, e in zip(run["steps"], first, strict=True))
            for run in runs[1:]
        ]
        newton = [[step["newton"] for step in run["steps"]] for run in runs]
        same = _bits(again) == _bits(runs[-1])
        row: Row = {
            "scene": scene,
            "element": element,
            "preconditioner": "jacobi" if options else "default",
            "cells": runs[0]["cells"],
            "ranks": counts,
            "newton": newton,
            "energy_differences": differences,
            "same_bits": same,
            "limit": LIMIT,
            "ok": same and max(differences, default=0.0) <= LIMIT,
        }
        if options:
            row["ok"] &= all(found == newton[0] for found in newton)
        yield row


def _bits(record: dict[str, Any]) -> list[Any]:
    """Return what two runs on the same number of ranks must have in common exactly."""
    keys = ("load", "newton", "linear", "clamped", "energy", "residual", "volume_ratio", "min_J")
    return [[step[key] for key in keys] for step in record["steps"]]


def _run(scene: str, element: str, cells: int, ranks: int, options: tuple[str, ...]) -> Any:
    """Return the record (run.json) of a run in processes of its own."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "run")
        words = f"run {scene} --element {element} --cells {cells} --quiet --out {out}".split()
        done = subprocess.run(
            [*program(ranks), *words, "--", *options],
            env=environment(), capture_output=True, text=True,
        )  # fmt: skip
        if done.returncode:
            reason = done.stderr.strip()[-300:]
            raise BadInput(f"benchmark ranks: {scene} on {ranks} ranks failed: {reason}")
        return json.loads((out / "run.json").read_text())
