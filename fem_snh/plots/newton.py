"""Newton iterations of many runs: a histogram for each family of cases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fem_snh.errors import BadInput
from fem_snh.plots.style import colour, legend, subplots

_BINS = 24


def newton_figure(table: pd.DataFrame, path: Path) -> Figure:
    """How many cases took how many Newton iterations, those that do not hold in another colour.

    A panel for each family that has Newton iterations. BadInput for a table without any.
    """
    missing = [c for c in ("family", "newton", "holds", "must") if c not in table]
    if missing:
        raise BadInput(f"{path}: not a table of extremes: has no column {', '.join(missing)}")
    rows = table[table["newton"].notna() & (table["newton"] > 0)]
    if rows.empty:
        raise BadInput(f"{path}: holds no Newton iteration yet")
    families = list(dict.fromkeys(rows["family"]))
    figure, axes = subplots(len(families))
    for family, ax in zip(families, axes, strict=True):
        mine = rows[rows["family"] == family]
        edges = np.geomspace(1, max(2.0, 1.05 * rows["newton"].max()), _BINS + 1)
        groups = {
            "holds": mine[mine["holds"]],
            "does not hold": mine[~mine["holds"] & mine["must"]],
            "does not, and need not": mine[~mine["holds"] & ~mine["must"]],
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
