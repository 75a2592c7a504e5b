"""Measure one material: python -m fem_snh.studies.extremes.pointwise MATERIAL FOLDER [--quick].

Writes FOLDER/record.json: {"rows": [{"passed", ...}, ...], "seconds"}; FOLDER is created.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from fem_snh.atomic_files import replace_file
from fem_snh.studies.extremes import pointwise


def main(material: str, folder: str, *flags: str) -> int:
    """Measure a material and write its record."""
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    rows = list(pointwise.measure(material, "--quick" in flags))
    record = {"rows": rows, "seconds": time.perf_counter() - start}
    replace_file(out / "record.json", json.dumps(record, indent=1, default=_python_number) + "\n")
    return 0


def _python_number(value: Any) -> Any:
    """Return a number of numpy as one of Python, which JSON can hold."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__}: expected a number or text")


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
