"""Draw graphs of runs: volume change and iterations per step, and energies against time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, MultipleLocator

from fem_snh.errors import BadInput, choose
from fem_snh.records.run_record import Record, flat, results
from fem_snh.viewing.plots.style import (
    colour,
    draw_series,
    from_zero,
    legend,
    legend_entry,
    plain,
    style,
    subplots,
)
from fem_snh.viewing.stored_run import (
    axis_label,
    column_label,
    duration,
    load_name,
    load_range,
    material_name,
    number_text,
    one_line,
    poisson_ratio,
    read_record,
    unit_name,
)

#: Labels of the panels that every run has.
_LABELS = {
    "volume": "volume change [%]",
    "linear": "linear iterations per step",
    "newton": "Newton iterations per step",
}

#: Columns of energies, and their line styles; ``energy`` is the sum of the first three.
ENERGIES = {
    "kinetic": "-",
    "elastic": "--",
    "potential": ":",
    "energy": "-.",
    "dissipated": (0, (1, 3)),
}


def run_figure(records: Sequence[Record], newton: bool = False) -> Figure:
    """Return a graph of volume change and iterations per step, a line per record (run.json).

    If all runs have the result of `principal_result`, a panel shows it; if all are dynamic, a panel
    shows energies.
    """
    main = principal_result(records)
    steps = [steps_of(record, main) for record in records]
    panels = ["volume", "linear", *(["newton"] if newton else []), *([main] if main else [])]
    in_time = all(duration(record) is not None for record in records)
    figure, axes = subplots(len(panels) + in_time)
    if in_time:
        draw_energies(axes.pop(), records, names(records))
    for index, (name, table) in enumerate(zip(names(records), steps, strict=True)):
        draw_series(axes, panels, index, name, table, "x")
    load = plain(", ".join(dict.fromkeys(axis_label(record) for record in records)))
    labels = [_LABELS.get(panel) or plain(column_label(panel, records)) for panel in panels]
    for ax, label in zip(axes, labels, strict=True):
        ax.set_xlabel(load)
        ax.set_ylabel(label)
        if label.endswith("step"):
            from_zero(ax)
            ax.yaxis.set_major_locator(MaxNLocator(6, integer=True, steps=[1, 2, 5, 10]))
        else:
            ax.axhline(0, lw=0.8, color="0.6", zorder=1)
        if not in_time and all(_turns(load_range(record)) for record in records):
            ax.xaxis.set_major_locator(MultipleLocator(load_range(records[0])[1] / 4))
            ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: number_text(x)))
    if any((~table["converged"]).any() for table in steps):
        legend_entry(axes[0], "not converged", "x")
    legend(figure, axes[0])
    common = {str(record["scene"]) for record in records}
    nus = {poisson_ratio(record) for record in records}
    if len(common) == len(nus) == 1:
        figure.suptitle(rf"{plain(common.pop())}  ·  $\nu$ = {nus.pop()}", fontsize=11)
    return figure


def steps_of(record: Record, main: str = "") -> pd.DataFrame:
    """Return a table with a row for the state at rest and one for each step.

    The columns are x (load parameter), volume (change, [%]), linear and newton (iterations),
    converged, and the result ``main`` if it is not "". BadInput if there is no step.
    """
    try:
        table = pd.DataFrame(record["steps"])
        low, high = load_range(record)
        steps = pd.DataFrame(
            {
                "x": low + table["load"].astype(float) * (high - low),
                "volume": 100 * (table["volume_ratio"].astype(float) - 1),
                "linear": table["linear"].astype(float),
                "newton": table["newton"].astype(float),
                "converged": table["converged"].astype(bool),
            }
        )
    except (KeyError, TypeError, ValueError) as error:
        what = "no step yet" if not record["steps"] else f"steps without {one_line(error)}"
        raise BadInput(f"run of '{record['scene']}': nothing to plot: {what}") from None
    if main:
        steps.loc[steps["converged"], main] = column(run_table(record), main).to_numpy()
    rest = pd.DataFrame({"x": [low], "volume": [0.0], "converged": [True]})
    return pd.concat([rest, steps], ignore_index=True)


def names(records: Sequence[Record]) -> list[str]:
    """Return a legend entry per record: the material and the values that differ between them."""
    traits = [
        {
            "nu": f"ν = {poisson_ratio(r)}",
            "scene": str(r["scene"]),
            "hessian": f"{r.get('hessian')} Hessian",
            "element": str(r.get("element")),
            "cells": f"{r.get('cells')} cells",
        }
        for r in records
    ]
    differ = [k for k in traits[0] if len({t[k] for t in traits}) > 1]
    return [
        ", ".join([material_name(r), *(t[k] for k in differ)])
        for r, t in zip(records, traits, strict=True)
    ]


def _turns(span: tuple[float, float]) -> bool:
    return "π" in number_text(span[1]) and span[0] == 0


def draw_energies(ax: Axes, records: Sequence[Record], names: Sequence[str]) -> None:
    """Draw the energies of one dynamic run, or the sums of several, against time.

    Parameters
    ----------
    ax : Axes
        The panel.
    records : sequence of dict
        The runs' run.json.
    names : sequence of str
        The runs' legend entries; a run has the same colour in all panels.
    """
    single = len(records) == 1
    for number, (record, name) in enumerate(zip(records, names, strict=True)):
        rows = energy_table(record)
        if not single:
            ax.plot(rows["time"], rows["energy"], label=plain(name), **style(number, len(rows)))
            continue
        for place, (key, line) in enumerate(ENERGIES.items()):
            if key in rows and rows[key].any():
                label = "sum" if key == "energy" else key
                ax.plot(rows["time"], rows[key], color=colour(place), ls=line, lw=1.6, label=label)
        ax.legend(frameon=False, fontsize=8)
    kind = "" if single else "kinetic + elastic + potential "
    ax.set_ylabel(f"{kind}energy [{unit_name('J', records)}]")
    ax.set_xlabel(f"time [{unit_name('s', records)}]")


def energy_table(record: Record) -> pd.DataFrame:
    """Return the initial state and the converged steps of a dynamic run as a table."""
    steps = [step for step in record["steps"] if step["converged"]]
    return pd.DataFrame([{"time": 0.0, **record["time"]["start"]}, *steps])


def run_table(record: Record) -> pd.DataFrame:
    """Return the converged steps of a run as a table, with a column named by `load_name`.

    Raises
    ------
    BadInput
        If no step has converged.
    """
    rows = [flat(step) for step in record["steps"] if step.get("converged", True)]
    if not rows:
        raise BadInput(f"run of '{record['scene']}': nothing to plot: no step has converged")
    table = pd.DataFrame(rows)
    low, high = load_range(record)
    table[load_name(record)] = low + table["load"].astype(float) * (high - low)
    return table


def list_columns(folder: Path) -> list[str]:
    """Return a line for each numeric column of a run's steps: name, value, unit.

    The value is that of the last converged step. The unit is given if the scene states its units.

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
    """Return the columns that have numbers, as floats; other entries are NaN."""
    return table.apply(pd.to_numeric, errors="coerce").astype(float).dropna(axis=1, how="all")


def column(table: pd.DataFrame, name: str) -> pd.Series:
    """Return a column, or the quotient A/B of two columns, as numbers.

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
        values: dict[Any, pd.Series] = {n: column(table, name) for n, name in enumerate(y)}
        curves = pd.DataFrame(values | {"x": column(table, x)})
        if "point" in table:  # of a study, whose order says nothing; the steps of a run are a path
            curves = curves.sort_values("x", kind="stable")
        draw_series(axes, range(len(y)), index, label, curves, "x")
    for ax, name in zip(axes, y, strict=True):
        ax.set_xlabel(plain(label_of(x)))
        ax.set_ylabel(plain(label_of(name)))
    legend(figure, axes[0])
    return figure


def principal_result(records: Sequence[Record]) -> str:
    """Return the column of the largest reaction component that all runs have, or "".

    Moments, which a scene requests by their point, precede forces. The values are those of the last
    converged step of the first run.
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


def x_of(records: Sequence[Record]) -> str:
    """Return the name of the runs' load parameter, the default of ``x``.

    Raises
    ------
    BadInput
        If the names differ.
    """
    names = {load_name(record) for record in records}
    if len(names) > 1:
        raise BadInput(f"--x: expected a column, as the runs have {', '.join(sorted(names))}")
    return names.pop()
