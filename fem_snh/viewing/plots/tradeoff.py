"""Draw work-precision diagrams: error of the displacement against time and unknowns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from fem_snh.errors import BadInput
from fem_snh.viewing.plots.style import colour, legend, legend_entry, plain, style, thousands

#: The measures of work, with their axis labels.
WORK = {"cpu": "processor time [s]", "dofs": "degrees of freedom"}
_NEEDED = (
    "scene", "nu", "element", "default", "converged", "error_displacement", "floor_displacement",
    "shift",
)  # fmt: skip
#: The order of colours, independent of the elements in a table.
_ELEMENTS = ("Q1", "Q1P0", "Q2", "Q2Q1", "P1", "P2P0", "P2", "P2P1")


def tradeoff_figure(table: pd.DataFrame, path: Path) -> Figure:
    """Return a row of two panels for each nu: error against time and against unknowns.

    A line joins the meshes of an element with default settings. Small circles are rows with a
    changed setting, the grey line is the Pareto front, and the shaded errors are below the
    resolution of the reference.

    Raises
    ------
    BadInput
        If the table has no errors.
    """
    missing = [column for column in (*_NEEDED, *WORK) if column not in table]
    if missing:
        raise BadInput(f"{path}: not the table of a tradeoff: has no column {', '.join(missing)}")
    good = table["converged"].astype(str).eq("True") & table["error_displacement"].notna()
    if not good.any():
        raise BadInput(f"{path}: holds no error yet: the study has no reference")
    moved = table["error_displacement"] + table["shift"].fillna(0)  # with the effect of the setting
    rows = table[good].assign(error=100 * np.maximum(moved, table["floor_displacement"]))
    nus = sorted(rows["nu"].unique())
    figure = Figure(figsize=(9.2, 2.9 * len(nus) + 0.6), layout="constrained")
    panels = figure.subplots(len(nus), 2, squeeze=False, sharey="row", sharex="col")
    for nu, axes in zip(nus, panels, strict=True):
        mine = rows[rows["nu"] == nu]
        for ax, (column, label) in zip(axes, WORK.items(), strict=True):
            _panel(ax, mine, column)
            if nu == nus[-1]:
                ax.set_xlabel(label)
        axes[0].set_ylabel("error of displacement [%]")
        axes[0].set_title(rf"$\nu$ = {nu:g}", fontsize=10, loc="left")
    first = panels[0][0]
    shown = first.get_legend_handles_labels()[1]
    for index, element in enumerate(_ELEMENTS):
        if element in set(rows["element"]) and element not in shown:
            first.plot([], [], label=element, **style(index, 1))
    legend_entry(first, "other settings", "o")
    legend(figure, first)
    figure.suptitle(plain(str(rows["scene"].iloc[0])), fontsize=11)
    return figure


def _panel(ax: Axes, rows: pd.DataFrame, column: str) -> None:
    ax.grid(True, lw=0.4, color="0.85")
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_xscale("log")
    ax.set_yscale("log")
    default = rows["default"].astype(str).eq("True")
    for index, element in enumerate(_ELEMENTS):
        mine = rows[rows["element"] == element]
        line = mine[default[mine.index]].sort_values("h", ascending=False)
        if len(line):
            ax.plot(line[column], line["error"], label=element, **style(index, len(line)))
        turned = mine[~default[mine.index]]
        ax.plot(
            turned[column], turned["error"], "o", ms=3.5, mfc="none", mec=colour(index), mew=0.8
        )
    best = _front(rows, column)
    ax.plot(
        best[column], best["error"], color="0.55", lw=5, alpha=0.35, drawstyle="steps-post",
        zorder=1, label="Pareto front",
    )  # fmt: skip
    floor = 100 * rows["floor_displacement"].max()
    low, high = rows["error"].min(), rows["error"].max()
    ax.set_ylim(min(floor, low) / 1.6, high * 1.6)
    ax.axhspan(min(floor, low) / 1.6, floor, color="0.92", zorder=0, lw=0)
    for axis, format in ((ax.yaxis, _percent), (ax.xaxis, thousands)):
        axis.set_major_locator(LogLocator(subs=(1,) if _wide(axis) else (1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(format))
        axis.set_minor_formatter(NullFormatter())


def _wide(axis: Any) -> bool:
    """Return whether an axis spans so many decades that powers of ten suffice as ticks (2.5)."""
    low, high = axis.get_view_interval()
    return bool(high > 300 * low)


def _percent(value: float, _: object) -> str:
    return f"{value:g}"


def _front(rows: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return the rows than which no row with less work is as accurate (the Pareto front)."""
    rows = rows.sort_values([column, "error"])
    before = np.minimum.accumulate(rows["error"].to_numpy())
    better = np.r_[True, rows["error"].to_numpy()[1:] < before[:-1]]
    return rows[better]
