"""One case that is no run of a scene: python -m fem_snh.studies.extremes FAMILY CASE FOLDER.

Leaves FOLDER/record.json: {"rows": [{"holds", ...}, ...], "seconds"}. FOLDER is made if need be.
"""

from __future__ import annotations

import json
import sys
import time
from importlib import import_module
from pathlib import Path

from fem_snh.atomic_files import put


def main(family: str, case: str, folder: str, *flags: str) -> int:
    """Measure a case of a family and write its record."""
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    measured = import_module("fem_snh.studies.extremes.measured")
    rows = measured.rows(family, case, out / "case", "--quick" in flags)
    record = {"rows": rows, "seconds": time.perf_counter() - start}
    put(out / "record.json", json.dumps(record, indent=1, default=measured.plain) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
