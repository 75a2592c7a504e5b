"""Draw graphs of a sweep: results against Poisson's ratio, or errors against their cost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from pandas.api.types import is_numeric_dtype

from fem_snh.errors import BadInput
from fem_snh.viewing.plots.runs import column
from fem_snh.viewing.plots.style import (
    draw_series,
    from_zero,
    legend,
    legend_entry,
    plain,
    subplots,
    thousands,
)
from fem_snh.viewing.stored_run import one_line, pretty

#: The columns that are plotted, with their axis labels.
MEASURES = {
    "newton": "Newton iterations",
    "linear": "linear iterations",
    "volume_ratio": "volume change [%]",
    "seconds": "time [s]",
}


def read_table(path: Path) -> pd.DataFrame:
    """Return a CSV file as a table; raise BadInput if it cannot be read."""
    try:
        return pd.read_csv(path)
    except FileNotFoundError:
        raise BadInput(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # pandas' parser errors are ValueErrors
        raise BadInput(f"{path}: cannot be read as CSV: {one_line(error)}") from None


def read_sweep(path: Path) -> pd.DataFrame:
    """Return the table of a sweep; its ``volume_ratio`` becomes the change of volume [%].

    Missing results of a failed point are NaN. Rows with nu >= 1/2 are dropped if nu varies.
    Poisson's ratios of several materials, "0.5 + 0.3", stay texts.

    Raises
    ------
    BadInput
        If the file is not the table of a sweep or has no results.
    """
    table = read_table(path)
    missing = [c for c in ("nu", "material", "converged", *MEASURES) if c not in table]
    if missing:
        raise BadInput(f"{path}: not the table of a sweep: has no column {', '.join(missing)}")
    try:
        for column in MEASURES:
            table[column] = pd.to_numeric(table[column])
    except ValueError as error:
        raise BadInput(f"{path}: column {column}: {one_line(error)}") from None
    table["converged"] = table["converged"].astype(str).str.lower() == "true"
    table["volume_ratio"] = 100 * (table["volume_ratio"] - 1)
    nothing_done = ~table["converged"] & (table["newton"] == 0)
    table.loc[nothing_done, ["newton", "linear"]] = float("nan")
    if table["nu"].nunique() > 1 and is_numeric_dtype(table["nu"]):
        table = table[table["nu"] < 0.5].copy()  # nu = 1/2 is not on the logarithmic axis
    if table[list(MEASURES)].isna().all(axis=None):
        raise BadInput(f"{path}: holds no result yet")
    return table


def sweep_figure(table: pd.DataFrame) -> Figure:
    """Return panels against nu, with a line per material and combination of other values.

    If nu has one value or is a text, the axis is the first other number that was varied, if any;
    else nu, or the number of the point for a text. A failed point is a cross at its value, if it
    has one.
    """
    varied = varied_columns(table)
    numbers = [c for c in varied if is_numeric_dtype(table[c])]
    single = table["nu"].nunique() == 1 and is_numeric_dtype(table["nu"])
    if not is_numeric_dtype(table["nu"]):
        varied += ["nu"] if table["nu"].nunique() > 1 else []
        table = table.assign(point=range(1, len(table) + 1))
        axis = numbers[0] if numbers else "point"
    else:
        axis = numbers[0] if numbers and single else "nu"
    # The axis is log(1/2 - nu), with the incompressible limit to the right.
    towards_half = axis == "nu" and bool((table["nu"] < 0.5).all())
    position = (0.5 - table["nu"]) if towards_half else table[axis].astype(float)
    table = table.assign(position=position).sort_values(axis)
    figure, axes = subplots(len(MEASURES))
    for index, (name, rows) in enumerate(_series(table, [c for c in varied if c != axis])):
        draw_series(axes, MEASURES, index, name, rows, "position")
    ticks = table.drop_duplicates(axis)[[axis, "position"]]
    for ax, (measure, label) in zip(axes, MEASURES.items(), strict=True):
        ax.set_ylabel(label)
        ax.set_xlabel(r"Poisson's ratio $\nu$" if axis == "nu" else plain(axis))
        _place_ticks(
            ax, ticks["position"].tolist(), [f"{v:.6g}" for v in ticks[axis]], towards_half
        )
        _scale(ax, measure, table[measure])
    if not table["converged"].all():
        legend_entry(axes[0], "not converged", "x")
    legend(figure, axes[0])
    if "scene" in table and table["scene"].nunique() == 1:
        same = [rf"$\nu$ = {table['nu'].iloc[0]:g}"] if axis != "nu" and single else []
        scene = plain(str(table["scene"].iloc[0]))
        figure.suptitle("  ·  ".join([scene, *same]), fontsize=11)
    return figure


def varied_columns(table: pd.DataFrame) -> list[str]:
    """Return the columns before ``converged`` that vary, except material, nu and results.

    A column that an earlier one determines is omitted: the default globalization of an element.
    """
    requested = table.columns[: table.columns.get_loc("converged")]
    skip = ("point", "material", "nu", *MEASURES)
    varied: list[str] = []
    for name in requested:
        if name in skip or table[name].nunique(dropna=False) < 2:
            continue
        if not any(_determines(table, earlier, name) for earlier in varied):
            varied.append(name)
    return varied


def _determines(table: pd.DataFrame, one: str, other: str) -> bool:
    """Return whether equal values in column ``one`` imply equal values in column ``other``."""
    return bool(table.groupby(one, dropna=False)[other].nunique(dropna=False).max() == 1)


def by_material(table: pd.DataFrame, *x: str) -> dict[str, pd.DataFrame]:
    """Return {label: converged points} by material and combination of varied values except ``x``.

    Without a column converged or material, all rows are one entry.
    """
    if "converged" not in table or "material" not in table:
        return {"all points": table}
    good = table[table["converged"].astype(str).str.lower() == "true"]
    varied = [c for c in ("nu", *varied_columns(table)) if c not in x and table[c].nunique() > 1]
    return dict(_series(good, varied))


def _series(table: pd.DataFrame, varied: list[str]) -> Iterator[tuple[str, pd.DataFrame]]:
    for key, rows in table.groupby(["material", *varied], sort=False, dropna=False):
        material, *rest = key
        extra = [_label(name, value) for name, value in zip(varied, rest, strict=True)]
        yield ", ".join([pretty(str(material)), *extra]), rows


def _label(name: str, value: Any) -> str:
    return value if isinstance(value, str) and name != "nu" else f"{name} {value}"


def _place_ticks(ax: Axes, positions: list[float], labels: list[str], towards_half: bool) -> None:
    if towards_half:
        ax.set_xscale("log")
        ax.set_xlim(2 * max(positions), min(positions) / 2)
    ax.xaxis.set_major_locator(FixedLocator(positions))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xticklabels(labels, rotation=45 if len(labels) > 5 else 0)


def _scale(ax: Axes, measure: str, values: pd.Series) -> None:
    """Start the axis at zero, or make it logarithmic if the values span a factor of 30."""
    positive = values[values > 0]
    if measure == "volume_ratio":
        ax.axhline(0, lw=0.8, color="0.6", zorder=1)
    elif len(positive) and positive.max() > 30 * positive.min():
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(FuncFormatter(thousands))
    else:
        from_zero(ax)


#: The columns of costs, with their axis labels.
COSTS = {
    "seconds": "time [s]",
    "dofs": "degrees of freedom",
    "num_cells": "cells",
    "newton": "Newton iterations",
    "linear": "linear iterations",
}
#: Columns of the resolution: the points of a line differ only in these.
_RESOLUTION = ("cells", "mesh", "steps")


def is_error_over_cost(x: str, y: Sequence[str]) -> bool:
    """Return whether ``x`` is a cost and ``y`` one error: of all goals, or ``corner.y.error``.

    The quotient of an error and its value, ``corner.y.error/corner.y``, is an error, too.
    """
    return x in COSTS and len(y) == 1 and y[0].partition("/")[0].split(".")[-1] == "error"


def front_figure(table: pd.DataFrame, x: str, y: str, path: Path) -> Figure:
    """Return a graph of an error's size over a cost, with rings and labels at the best points.

    A line joins the points that differ in resolution only.

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
        rows = rows[["cost", "size"]].sort_values("size", ascending=False)
        draw_series([ax], ["size"], index, label, rows, "cost")
    best = pd.concat(pareto_front(rows, "cost", "size") for rows in _problems(lines))
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


def pareto_front(rows: pd.DataFrame, cost: str, error: str) -> pd.DataFrame:
    """Return the Pareto-optimal rows, sorted by cost: none is both cheaper and more accurate."""
    rows = rows.sort_values([cost, error])
    before = np.minimum.accumulate(rows[error].to_numpy())
    better = np.r_[True, rows[error].to_numpy()[1:] < before[:-1]]
    return rows[better]


def _problems(lines: dict[str, pd.DataFrame]) -> list[pd.DataFrame]:
    """Return the points of all lines by material and Poisson's ratio: these are compared."""
    table = pd.concat(lines.values())
    keys = [name for name in ("material", "nu") if name in table]
    return [rows for _, rows in table.groupby(keys, dropna=False)] if keys else [table]
