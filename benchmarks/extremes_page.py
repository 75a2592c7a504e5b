"""The results of `fem-snh extremes` in docs/results, rewritten from their CSV file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from benchmarks import Row, page_tables
from fem_snh.studies.extremes.study import page


def rows(write: str = "docs/results/extremes_tables.md") -> Iterator[Row]:
    """Rewrite the part of a page between its markers.

    The rows and pictures are those in its data folder. One row is yielded, with the
    number of cases.
    """
    path = Path(write)
    parts = page_tables.split_page(path, "extremes_page")
    folder = page_tables.data_folder(path)
    table = pd.read_csv(folder / "extremes.csv")
    text = page(table, folder, f"{folder.name}/")
    page_tables.write_table(path, "extremes_page", parts, text.strip())
    yield {"page": write, "cases": len(table)}
