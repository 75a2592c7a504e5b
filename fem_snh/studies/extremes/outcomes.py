"""What the families with obstacles share: the criterion of a clear end, and their tables."""

from __future__ import annotations

import pandas as pd

from fem_snh.studies.extremes.cases import Record, Row
from fem_snh.studies.markdown import markdown_table

#: The criterion of `ends_clearly`, in words.
CLEAR = "converges, or says why not and keeps its steps"


def ends_clearly(record: Record, row: Row) -> str:
    """Check that a run converged, or stopped with a reason and the steps that it has solved."""
    if row["converged"] is True:
        return ""
    status = str(row["status"])
    if not status.startswith("stopped at "):
        return status  # a crash, a timeout, an error
    solved = [step["load"] for step in record["steps"] if step["converged"]]
    if not record["steps"] or "(" not in status:
        return f"no reason: {status}"
    reached = float(status.removeprefix("stopped at load ").partition(":")[0])
    last = max(solved, default=0.0)
    return "" if abs(reached - last) < 1e-9 else f"{status}, but the last step is at load {last:g}"


def table(rows: pd.DataFrame, family: str) -> str:
    """Return a line for each run."""
    lines = [
        [
            row["point"].removeprefix(f"{family}-"),
            row["reason"] or row["status"],
            *(_number(row[key], ",.0f") for key in ("newton", "clamped", "linear")),
            _number(row["load"], ".3g"), _number(row["min_J"], ".3f"),
            _number(row["energy"], ".4g"), _number(row["seconds"], ".1f"),
        ]
        for row in rows.astype({"reason": object}).fillna({"reason": ""}).to_dict("records")
    ]  # fmt: skip
    head = [
        "case", "result", "Newton", "filtered", "linear", "load reached", "min J", "energy [J]",
        "seconds",
    ]  # fmt: skip
    return markdown_table(head, lines)


def _number(value: float, format: str) -> str:
    return "-" if value != value else f"{value:{format}}"
