"""Draw histograms of Newton iterations, one for each family of `fem-snh extremes`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fem_snh.errors import BadInput
from fem_snh.viewing.plots.style import colour, legend, subplots

_BINS = 24


def newton_figure(table: pd.DataFrame, path: Path) -> Figure:
    """Return a histogram of Newton iterations for each family, failed cases in other colours.

    Parameters
    ----------
    table : pandas.DataFrame
        The rows of an extremes.csv.
    path : Path
        Path of the table, for messages.

    Raises
    ------
    BadInput
        If the table is not of extremes or has no Newton iterations.
    """
    missing = [c for c in ("family", "newton", "passed", "expected") if c not in table]
    if missing:
        raise BadInput(f"{path}: not a table of extremes: has no column {', '.join(missing)}")
    rows = table[table["newton"].notna() & (table["newton"] > 0)]
    if rows.empty:
        raise BadInput(f"{path}: has no Newton iterations yet")
    families = list(dict.fromkeys(rows["family"]))
    figure, axes = subplots(len(families))
    for family, ax in zip(families, axes, strict=True):
        mine = rows[rows["family"] == family]
        required = mine["expected"] == "pass"
        edges = np.geomspace(1, max(2.0, 1.05 * rows["newton"].max()), _BINS + 1)
        groups = {
            "passed": mine[mine["passed"]],
            "failed": mine[~mine["passed"] & required],
            "failed, as it may": mine[~mine["passed"] & ~required],
        }
        ax.hist(
            [group["newton"] for group in groups.values()],
            bins=edges, stacked=True, label=list(groups), color=[colour(k) for k in (0, 1, 4)],
        )  # fmt: skip
        ax.set_xscale("log")
        ax.set_title(family, fontsize=10, loc="left")
        ax.set_xlabel("Newton iterations")
        ax.set_ylabel("cases")
        ax.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    legend(figure, axes[0])
    return figure
