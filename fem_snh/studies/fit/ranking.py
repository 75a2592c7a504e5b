"""The table of a ranking of materials."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from fem_snh.files import write_file
from fem_snh.studies.fit.result import Fit

#: The columns of ranking.csv.
COLUMNS = ("rank", "material", "parameters", "r_squared", "rms", "aicc", "stable_at_data")


def write_ranking(fits: Sequence[Fit], path: Path) -> None:
    """Write fits in their order as CSV; raise BadInput if ``path`` cannot be written."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*COLUMNS, *(f"stable_{s.kind}" for s in fits[0].stable)))
    for place, f in enumerate(fits, start=1):
        ranges = [f"{s.low:.6g} to {s.high:.6g}" for s in f.stable]
        writer.writerow(
            (
                place,
                f.name,
                len(f.parameters),
                f.r_squared,
                f.rms,
                f.aicc,
                f.stable_at_data,
                *ranges,
            )
        )
    write_file(path, text.getvalue())
