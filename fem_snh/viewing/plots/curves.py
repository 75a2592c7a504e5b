"""Draw curves of results: any column of runs or of a sweep over any other.

Columns are those of steps.csv and sweep.csv: ``inner.moment.z``, ``corner.y``, ``volume_ratio``. A
run has its load parameter, too, by its name: ``angle``. ``A/B`` is the quotient of two columns, as
a stiffness: ``right.force.x/corner.x``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from fem_snh.errors import BadInput, choose
from fem_snh.records.run_tables import flat, results
from fem_snh.viewing.plots.style import legend, plain, style, subplots
from fem_snh.viewing.render import read_record
from fem_snh.viewing.render.records import column_label, load_name, load_range


def run_table(record: Mapping[str, Any]) -> pd.DataFrame:
    """Return the steps of a run that converged as a table, with its load parameter by name.

    Raises
    ------
    BadInput
        If no step has converged.
    """
    rows = [flat(step) for step in record["steps"] if step.get("converged", True)]
    if not rows:
        raise BadInput(f"run of '{record['scene']}': nothing to plot: no step has converged")
    table = pd.DataFrame(rows)
    low, high = load_range(dict(record))
    table[load_name(dict(record))] = low + table["load"].astype(float) * (high - low)
    return table


def list_columns(folder: Path) -> list[str]:
    """Return a line for each column of a run's steps that has numbers: name, value, unit.

    The values are those of the last step that converged. Units are those that the scene states.

    Raises
    ------
    BadInput
        If the folder is not that of a run, or no step has converged.
    """
    record = read_record(folder)
    rows = []
    for name, number in numbers(run_table(record)).iloc[-1].dropna().items():
        unit = column_label(str(name), [record]).removeprefix(str(name)).strip(" []")
        rows.append((str(name), f"{number:.6g}", unit))
    wide, digits = (max(len(row[k]) for row in rows) for k in (0, 1))
    return [f"{name:{wide}}  {number:>{digits}}  {unit}".rstrip() for name, number, unit in rows]


def numbers(table: pd.DataFrame) -> pd.DataFrame:
    """Return the columns that have numbers, as numbers."""
    return table.apply(pd.to_numeric, errors="coerce").astype(float).dropna(axis=1, how="all")


def column(table: pd.DataFrame, name: str) -> pd.Series:
    """Return a column, or the quotient of two, as numbers.

    Raises
    ------
    BadInput
        For a column that the table does not have, or that has no numbers.
    """
    if name not in table and "/" in name:
        for at in (i for i, letter in enumerate(name) if letter == "/"):
            above, below = name[:at], name[at + 1 :]
            if above in table and below in table:
                return column(table, above) / column(table, below)
    choose("column", name, list(numbers(table)))
    return pd.to_numeric(table[name], errors="coerce")


def curve_figure(
    tables: Mapping[str, pd.DataFrame],
    x: str,
    y: Sequence[str],
    label_of: Callable[[str], str] = str,
) -> Figure:
    """Return a panel for each of ``y`` over ``x``, with a line for each table.

    ``label_of`` returns the label of a column.

    Raises
    ------
    BadInput
        For a column that a table does not have.
    """
    figure, axes = subplots(len(y))
    for index, (label, table) in enumerate(tables.items()):
        across = column(table, x)
        for ax, name in zip(axes, y, strict=True):
            values = column(table, name)
            order = across.sort_values(kind="stable").index if _is_study(table) else across.index
            ax.plot(across[order], values[order], label=plain(label), **style(index, len(table)))
    for ax, name in zip(axes, y, strict=True):
        ax.set_xlabel(plain(label_of(x)))
        ax.set_ylabel(plain(label_of(name)))
    legend(figure, axes[0])
    return figure


def _is_study(table: pd.DataFrame) -> bool:
    """Return whether rows are points, whose order says nothing; the steps of a run are a path."""
    return "point" in table


def principal_result(records: Sequence[Mapping[str, Any]]) -> str:
    """Return the column of the largest component of a reaction that all runs have, or "".

    A moment, which the scene asks for by its point, comes before a force.
    """
    good = [[s for s in record["steps"] if s.get("converged", True)] for record in records]
    if not all(good):
        return ""
    first, *others = [results(steps[-1]) for steps in good]
    for kind in (".moment.", ".force."):
        names = [name for name in first if kind in name and all(name in row for row in others)]
        sizes = {name: abs(first[name] or 0.0) for name in names}
        if sizes and max(sizes.values()) > 0:
            return max(sizes, key=lambda name: sizes[name])
    return ""


def x_of(records: Sequence[Mapping[str, Any]]) -> str:
    """Return the default of ``x`` for runs: their load parameter.

    Raises
    ------
    BadInput
        If they differ in it.
    """
    names = {load_name(dict(record)) for record in records}
    if len(names) > 1:
        raise BadInput(f"--x: expected a column, as the runs have {', '.join(sorted(names))}")
    return names.pop()
