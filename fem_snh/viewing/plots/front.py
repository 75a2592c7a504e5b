"""Draw the error of the points of a sweep over their cost, and mark the best points.

A point is best if no other point of the same material and Poisson's ratio is both cheaper and more
accurate: the best points are the Pareto front.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from fem_snh.errors import BadInput
from fem_snh.viewing.plots.curves import column
from fem_snh.viewing.plots.style import legend, plain, style, subplots
from fem_snh.viewing.plots.sweeps import by_material, varied_columns

#: The columns of costs, with their axis labels.
COSTS = {
    "seconds": "time [s]",
    "dofs": "degrees of freedom",
    "num_cells": "cells",
    "newton": "Newton iterations",
    "linear": "linear iterations",
}
#: Columns that set the resolution: the points of a line differ in them.
_RESOLUTION = ("cells", "mesh", "steps")


def is_error_over_cost(x: str, y: Sequence[str]) -> bool:
    """Return whether columns are a cost and one error, of all goals or of one (``corner.y.error``).

    A quotient of an error and its value is one, too: ``corner.y.error/corner.y``.
    """
    return x in COSTS and len(y) == 1 and y[0].partition("/")[0].split(".")[-1] == "error"


def front_figure(table: pd.DataFrame, x: str, y: str, path: Path) -> Figure:
    """Return the size of an error over a cost, with rings and labels at the best points.

    A line joins the resolutions of one choice of all other values.

    Raises
    ------
    BadInput
        For a column that the table does not have, or if no point that converged has an error.
    """
    if y not in table and y == "error":
        raise BadInput(f"{path}: has no column error: expected a sweep with --error")
    table = table.assign(cost=column(table, x), size=column(table, y).abs())
    table = table[(table["cost"] > 0) & (table["size"] > 0)]
    lines = by_material(table, x, *_RESOLUTION)
    if not lines:
        raise BadInput(f"{path}: no point that converged has a column {y} with a number above 0")
    figure, (ax,) = subplots(1)
    figure.set_size_inches(6.4, 4.6)
    for index, (label, rows) in enumerate(lines.items()):
        rows = rows.sort_values("size", ascending=False)
        ax.plot(rows["cost"], rows["size"], label=plain(label), **style(index, len(rows)))
    best = pd.concat(best_points(rows, "cost", "size") for rows in _problems(lines))
    ax.plot(
        best["cost"], best["size"], "o", ms=11, mfc="none", mec="0.2", mew=1.2,
        label="best: no point is both cheaper and more accurate",
    )  # fmt: skip
    varied = [name for name in varied_columns(table) if name not in COSTS]
    for _, row in best.iterrows():
        text = ", ".join(str(row[name]) for name in varied)
        ax.annotate(
            plain(text), (row["cost"], row["size"]), (7, 5), textcoords="offset points", fontsize=7
        )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel(COSTS[x])
    ax.set_ylabel("relative error" if y == "error" else plain(y))
    legend(figure, ax)
    return figure


def best_points(rows: pd.DataFrame, cost: str, error: str) -> pd.DataFrame:
    """Return the rows than which no other row is both cheaper and more accurate, by cost."""
    rows = rows.sort_values([cost, error])
    before = np.minimum.accumulate(rows[error].to_numpy())
    better = np.r_[True, rows[error].to_numpy()[1:] < before[:-1]]
    return rows[better]


def _problems(lines: dict[str, pd.DataFrame]) -> list[pd.DataFrame]:
    """Return the points of each material and Poisson's ratio, which are compared."""
    table = pd.concat(lines.values())
    keys = [name for name in ("material", "nu") if name in table]
    return [rows for _, rows in table.groupby(keys, dropna=False)] if keys else [table]
