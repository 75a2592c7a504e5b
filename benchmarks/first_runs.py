"""Processor time of first runs: with an empty cache, after ``fem-snh compile``, and once more."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from benchmarks import Row
from benchmarks.start import processor_seconds

#: The runs: options of ``fem-snh run``.
RUNS = (
    "twist --element Q1 --material stable_neo_hookean",
    "stretch --element P2 --material yeoh --nu 0.4",
    "twist --element Q2Q1 --material ogden --cells 4",
)


def rows(everything: bool = False) -> Iterator[Row]:
    """Start each run in caches of its own: one row for each, ok if it compiles nothing.

    Parameters
    ----------
    everything : bool
        Compile all materials on all elements, as ``make setup`` does, not only those of the run.
    """
    program = [sys.executable, "-m", "fem_snh"]
    for run in RUNS:
        _, _, element, _, material, *_ = run.split()
        chosen = [] if everything else [material, "--elements", element]
        command = [*program, "run", *run.split()]
        with TemporaryDirectory() as empty, TemporaryDirectory() as folder:
            with patch.dict(os.environ, _caches(empty)):
                first = processor_seconds(command)
            with patch.dict(os.environ, _caches(folder)):
                compiling = processor_seconds([*program, "compile", *chosen])
                size, compiled = _sizes(folder)
                after, again = processor_seconds(command), processor_seconds(command)
                new = _sizes(folder)[1] - compiled
        yield {
            "run": run,
            "empty cache [s]": round(first, 2),
            "compiled ahead [s]": round(after, 2),
            "second run [s]": round(again, 2),
            "compile [s]": round(compiling, 1),
            "cache [MB]": round(size / 1e6, 1),
            "new files": new,
            "ok": new == 0,
        }


def _caches(folder: str) -> dict[str, str]:
    """Return the variables of the cache of this package and of dolfinx's."""
    return {"FEM_SNH_CACHE": f"{folder}/own", "XDG_CACHE_HOME": f"{folder}/dolfinx"}


def _sizes(folder: str) -> tuple[int, int]:
    """Return the bytes of all files in a folder, and the number of compiled ones."""
    files = [path for path in Path(folder).rglob("*") if path.is_file()]
    return sum(path.stat().st_size for path in files), sum(p.suffix in (".o", ".so") for p in files)
