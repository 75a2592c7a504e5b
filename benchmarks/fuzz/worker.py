"""Run cases of a family: ``python -m benchmarks.fuzz.worker FAMILY FIRST STOP FOLDER [keep]``.

It prints one line of JSON per case. With ``keep`` the folders of failed cases remain.
"""

from __future__ import annotations

import json
import shutil
import sys
from importlib import import_module
from pathlib import Path

from benchmarks.fuzz.family import load_families, run_case


def main(name: str, first: int, stop: int, folder: Path, keep: bool) -> None:
    """Run the cases with the seeds from ``first`` to ``stop``, without it."""
    family = load_families()[name]
    for module in family.preload:
        import_module(module)
    for seed in range(first, stop):
        outcome = run_case(name, family, seed, folder)
        if not (keep and outcome["failure"]):
            shutil.rmtree(folder / f"{name}-{seed}", ignore_errors=True)
        print(json.dumps(outcome), flush=True)


if __name__ == "__main__":
    main(
        sys.argv[1],
        int(sys.argv[2]),
        int(sys.argv[3]),
        Path(sys.argv[4]).resolve(),
        "keep" in sys.argv[5:],
    )
