"""The table of a study: a CSV file that is complete after every row."""

from __future__ import annotations

import csv
import io
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput
from fem_snh.files import read_text, replace_file
from fem_snh.records.run_record import problem
from fem_snh.records.run_tables import results

#: Columns of the settings of a run.
REQUESTED = "scene material E nu element cells hessian globalization predictor steps".split()
#: Columns of the results of a run.
MEASURED = (
    "converged status notes load newton clamped linear energy volume_ratio min_J residual "
    "seconds num_cells dofs"
).split()
#: The column of the estimated error, which tables of scenes with an estimate have.
ERROR = "error"
#: The column ``notes`` of a run without notes.
NO_NOTES = "none"


class StudyTable:
    """The rows of a study in a CSV file, one row per point. Only one process may write it.

    Parameters
    ----------
    path : Path
        The file; rows that it holds already are kept.
    columns : sequence of str
        Names of the columns; ``point`` is the key. Those of results, whose names contain a dot
        (``corner.y``, ``top.force.z``), are added when a row has them.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.path, self.columns = path, list(columns)
        rows = self.rows() if path.exists() else []
        self._add_results(rows[0] if rows else ())
        self.replace(rows)

    def rows(self) -> list[dict[str, str]]:
        """Return the rows as text, without a last line that was cut off.

        Raises BadInput for a file that is no such table.
        """
        try:
            text = read_text(self.path)
            rows = list(csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1])))
        except (OSError, ValueError, csv.Error) as error:
            raise BadInput(f"{self.path}: cannot be read ({error}): remove it") from None
        if any(None in row.values() or None in row or "point" not in row for row in rows):
            raise BadInput(f"{self.path}: expected a table with a column 'point': remove it")
        return rows

    def append(self, row: Mapping[str, Any]) -> None:
        """Append one row and flush it to the disk; keys that are no columns are left out."""
        if self._add_results(row):
            self.replace(self.rows())
        with self.path.open("a", encoding="utf-8", newline="") as file:
            self._writer(file).writerow(row)
            file.flush()
            os.fsync(file.fileno())

    def _add_results(self, keys: Iterable[str]) -> bool:
        """Add the columns of results; return whether there are new ones."""
        new = [key for key in keys if "." in key and key not in self.columns]
        self.columns += new
        return bool(new)

    def replace(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Replace all rows."""
        text = io.StringIO()
        writer = self._writer(text)
        writer.writeheader()
        writer.writerows(rows)
        replace_file(self.path, text.getvalue())

    def drop(self, points: Iterable[str]) -> None:
        """Remove the rows of these points."""
        removed = set(points)
        self.replace(row for row in self.rows() if row["point"] not in removed)

    def _writer(self, file: Any) -> csv.DictWriter[str]:
        return csv.DictWriter(
            file, self.columns, restval="", extrasaction="ignore", lineterminator="\n"
        )


def read_record(folder: Path) -> dict[str, Any]:
    """Return the record that a point left in its folder; empty if it left none that is whole."""
    try:
        record = json.loads(read_text(folder / "run.json"))
    except (OSError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) and not problem(record) else {}


def measured_columns(record: Mapping[str, Any], log: Path, code: int) -> dict[str, Any]:
    """Return the results of a run: the columns MEASURED, ``nonfinite``, ``max_u`` and `results`.

    ``notes`` has the kinds of the notes on the run, with spaces between.

    Iterations are summed over all steps, converged or not; energy, volume and the other state
    variables are those of the last converged step. ``seconds`` has neither the compilation nor,
    unless the run refines its mesh by it, the estimate of the errors. ``error`` is `largest_error`.

    Parameters
    ----------
    record : mapping
        Its run.json; empty if there is none.
    log : Path
        Its output.
    code : int
        Its exit code.
    """
    steps = record.get("steps", [])
    converged = [step for step in steps if step.get("converged")]
    summed = ("newton", "clamped", "linear", "nonfinite")
    last = ("load", "energy", "volume_ratio", "min_J", "residual", "max_u")
    row: dict[str, Any] = {key: sum(step.get(key) or 0 for step in steps) for key in summed}
    row |= {key: converged[-1].get(key) for key in last if converged}
    row |= results(converged[-1]) if converged else {}
    # Not empty: pandas would read a missing value.
    row["notes"] = " ".join(note["kind"] for note in record.get("notes", ())) or NO_NOTES
    row["converged"] = code == 0 and record.get("converged") is True
    row["status"] = record.get("status") if code in (0, 1) else None
    row["status"] = row["status"] or failure_message(log, code)
    row |= {"num_cells": record.get("cells"), "dofs": record.get("dofs")}
    seconds = record.get("seconds", {})
    if "total" in seconds:
        without = ("jit",) if "accuracy" in record else ("jit", "estimate")
        row["seconds"] = seconds["total"] - sum(seconds.get(key, 0.0) for key in without)
    else:
        row["seconds"] = None
    row[ERROR] = largest_error(record)
    # The defaults, if the scene names none.
    row |= {key: record[key] for key in ("hessian", "globalization") if key in record}
    return row


def largest_error(record: Mapping[str, Any]) -> float | None:
    """Return the largest relative error of a run's goals; None without an estimate.

    Errors of components are relative to the largest component. Where a goal has a bound of its
    error, the bound counts. A vector that is rounding has no relative error.
    """
    vectors: dict[str, list[Mapping[str, Any]]] = {}
    for name, goal in record.get("goals", {}).items():
        if goal.get("error") is not None:
            vectors.setdefault(re.sub(r"\.[xyz]$", "", name), []).append(goal)
    ratios = [
        max(goal.get("bound", abs(goal["error"])) for goal in goals)
        / max(abs(goal["value"]) for goal in goals)
        for goals in vectors.values()
        if any(goal.get("relative") is not None for goal in goals)
    ]
    return max(ratios, default=None)


def failure_message(log: Path, code: int) -> str:
    """Return why a point failed, from its log: its error message, or its last line."""
    reason = f"ended by signal {-code}" if code < 0 else f"exit code {code}"
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    errors = [line for line in lines if "fem-snh: error: " in line]
    if errors:
        return errors[-1].partition("fem-snh: error: ")[2]
    return f"{reason}: {lines[-1][:200]}" if lines else reason
