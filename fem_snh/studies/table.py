"""The table of a study as a CSV file that is whole after every row, whenever the writer dies."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fem_snh.atomic_files import put

ASKED = "scene material E nu element cells hessian predictor steps".split()
FOUND = (
    "converged status load newton clamped linear energy volume_ratio min_J residual "
    "seconds num_cells dofs"
).split()


class Table:
    """Rows by point in a CSV file. Only one process may write it."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.path, self.columns = path, list(columns)
        self._write(self.rows() if path.exists() else [])

    def rows(self) -> list[dict[str, str]]:
        """The rows as text; a last line that was cut off is left out."""
        whole = self.path.read_text(encoding="utf-8")
        whole = whole[: whole.rfind("\n") + 1]
        return list(csv.DictReader(io.StringIO(whole)))

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row and see it on the disk; what is not a column is left out."""
        with self.path.open("a", encoding="utf-8", newline="") as file:
            file.write(self._line(row))
            file.flush()
            os.fsync(file.fileno())

    def replace(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Put these rows in place of all there are."""
        self._write(rows)

    def drop(self, points: Iterable[str]) -> None:
        """Take the rows of these points out."""
        gone = set(points)
        self._write([row for row in self.rows() if row["point"] not in gone])

    def _write(self, rows: Sequence[Mapping[str, Any]]) -> None:
        lines = [self._line(dict(zip(self.columns, self.columns, strict=True)))]
        put(self.path, "".join(lines + [self._line(row) for row in rows]))

    def _line(self, row: Mapping[str, Any]) -> str:
        line = io.StringIO()
        csv.DictWriter(line, self.columns, restval="", extrasaction="ignore").writerow(row)
        return line.getvalue().replace("\r\n", "\n")


def read_record(folder: Path, name: str = "run.json") -> dict[str, Any]:
    """The record that a point left in its folder; empty if it did not come so far."""
    try:
        record: dict[str, Any] = json.loads((folder / name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return record


def found(record: Mapping[str, Any], log: Path, code: int) -> dict[str, Any]:
    """What a run has to say, as the columns FOUND: its run.json, its log and its exit code.

    Iterations and the like are summed over all steps, whatever became of them; energy, volume and
    the like are those of the last step that converged. Besides FOUND: ``nonfinite``, ``max_u``.
    """
    steps = record.get("steps", [])
    good = [step for step in steps if step.get("converged")]
    counted = ("newton", "clamped", "linear", "nonfinite")
    row: dict[str, Any] = {key: sum(step.get(key) or 0 for step in steps) for key in counted}
    row |= {key: good[-1].get(key) for key in ("load", "energy", "volume_ratio") if good}
    row |= {key: good[-1].get(key) for key in ("min_J", "residual", "max_u") if good}
    row["converged"] = code == 0 and record.get("converged") is True
    row["status"] = record.get("status") if code in (0, 1) else None
    row["status"] = row["status"] or last_words(log, code)
    row |= {"num_cells": record.get("cells"), "dofs": record.get("dofs")}
    row["seconds"] = record.get("seconds", {}).get("total")
    if "hessian" in record:
        row["hessian"] = record["hessian"]  # a scene that names none takes what suits it
    return row


def last_words(log: Path, code: int) -> str:
    """Why a point ended that could not say so in its record."""
    reason = f"ended by signal {-code}" if code < 0 else f"exit code {code}"
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    told = [line for line in lines if "fem-snh: error: " in line]
    if told:
        return told[-1].partition("fem-snh: error: ")[2]
    return f"{reason}: {lines[-1][:200]}" if lines else reason
