"""Draw graphs of runs (against load) and sweeps (against nu, or errors against their cost).

The command ``plot`` and the studies call them. They read files only: run.json, or the CSV file of a
study.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure

from fem_snh.errors import BadInput
from fem_snh.files import output_path, write_file
from fem_snh.records.run_record import Record
from fem_snh.viewing.plots.runs import curve_figure, run_figure, run_table, x_of
from fem_snh.viewing.plots.sweeps import (
    by_material,
    front_figure,
    is_error_over_cost,
    read_sweep,
    read_table,
    sweep_figure,
)
from fem_snh.viewing.stored_run import column_label, read_record


def main(
    paths: Sequence[Path],
    out: Path | None = None,
    newton: bool = False,
    x: str | None = None,
    y: Sequence[str] = (),
) -> Path:
    """Plot run folders in one graph, or the CSV file of one study, and return the picture's path.

    Parameters
    ----------
    paths : sequence of Path
        Folders of runs, or one CSV file or folder of a study.
    out : Path, optional
        The picture; default: history.png in the folder of a single run (curves.png with ``y``),
        comparison.png above several, and the name of the CSV file with .png.
    newton : bool
        Add a panel with the Newton iterations per step.
    x : str, optional
        The horizontal axis: a column of steps.csv or of the study's table, or a quotient A/B of
        two; default: the load parameter of runs.
    y : sequence of str, optional
        Columns or quotients, each drawn over ``x`` in a panel. An error of a sweep over its cost is
        drawn with the best points marked: see `fem_snh.viewing.plots.sweeps`.

    Raises
    ------
    BadInput
        If a file is missing, cannot be read or has no results, or ``out`` cannot be written.
    """
    paths = [Path(p) for p in paths]
    if not paths:
        raise BadInput("nothing to plot: give folders of runs, or one sweep.csv")
    tables = [_table_in(p) for p in paths]
    if any(t.suffix == ".csv" for t in tables):
        if len(tables) > 1:
            raise BadInput(f"{tables[0]}: plot one table at a time, without run folders")
        figure, default = _table_figure(tables[0], x, y), tables[0].with_suffix(".png")
        if y:
            default = default.with_name("curves.png")
    else:
        records = [read_record(p) for p in paths]
        if x is not None and not y:
            raise BadInput(f"--x {x}: expected with --y, the columns of the curves")
        if y:
            labels = paths if len(paths) > 1 else [str(records[0]["scene"])]
            found = dict(zip(map(str, labels), map(run_table, records), strict=True))
            label_of = partial(column_label, records=records)
            figure, name = curve_figure(found, x or x_of(records), y, label_of), "curves.png"
        else:
            figure, name = run_figure(records, newton), "history.png"
        above = Path(os.path.commonpath([p.resolve() for p in paths]))
        default = paths[0] / name if len(paths) == 1 else above / "comparison.png"
    return save(figure, output_path("--out", out) if out is not None else default)


def _table_in(path: Path) -> Path:
    """Return the CSV file in a sweep's folder, or any other path unchanged."""
    return path / "sweep.csv" if (path / "sweep.csv").is_file() else path


def _table_figure(path: Path, x: str | None, y: Sequence[str]) -> Figure:
    table = read_table(path)
    if y:
        if x is None:
            raise BadInput("--y: expected with --x, a column of the table")
        if is_error_over_cost(x, y):
            return front_figure(table, x, y[0], path)
        label_of = partial(column_label, records=_first_record(path.parent))
        return curve_figure(by_material(table, x), x, y, label_of)
    return sweep_figure(read_sweep(path))


def _first_record(folder: Path) -> list[Record]:
    """Return [run.json] of one point of a study, whose points have the same units, or []."""
    for path in sorted(folder.glob("*/run.json")):
        with suppress(BadInput):  # of a point that was killed
            return [read_record(path.parent)]
    return []


def save(figure: Figure, out: Path) -> Path:
    """Write a figure, in the format of ``out``'s suffix, create its folder, and return ``out``."""
    kinds = FigureCanvasBase.get_supported_filetypes()
    kind = out.suffix.lower().removeprefix(".")
    if kind not in kinds:
        raise BadInput(f"{out}: cannot be written: expected a file .{', .'.join(sorted(kinds))}")
    return write_file(out, lambda file: figure.savefig(file, dpi=200, format=kind))
