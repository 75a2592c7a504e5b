"""Graphs of runs (volume and linear iterations against load) and of sweeps (against nu).

They read files only: run.json, or a sweep's CSV.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from fem_snh.errors import BadInput
from fem_snh.plots.runs import run_figure
from fem_snh.plots.sweeps import read_sweep, sweep_figure
from fem_snh.render import one_line, read_record


def main(paths: Sequence[Path], out: Path | None = None, newton: bool = False) -> Path:
    """Plot run folders (overlaid), or one sweep's CSV, and return the picture's path.

    ``out`` defaults to history.png in a single run's folder, comparison.png above several, and the
    CSV's name with .png. ``newton`` adds Newton iterations per step. BadInput for what is missing,
    unreadable or no result, or if ``out`` cannot be written.
    """
    paths = [Path(p) for p in paths]
    if not paths:
        raise BadInput("nothing to plot: give folders of runs or one sweep.csv")
    tables = [p / "sweep.csv" if (p / "sweep.csv").is_file() else p for p in paths]
    if any(t.suffix == ".csv" for t in tables):
        if len(tables) > 1:
            raise BadInput(f"{tables[0]}: plot one sweep at a time, without run folders")
        figure, default = sweep_figure(read_sweep(tables[0])), tables[0].with_suffix(".png")
    else:
        figure = run_figure([read_record(p) for p in paths], newton)
        above = Path(os.path.commonpath([p.resolve() for p in paths]))
        default = paths[0] / "history.png" if len(paths) == 1 else above / "comparison.png"
    return save(figure, Path(out) if out is not None else default)


def save(figure: Figure, out: Path) -> Path:
    """Write the figure, making its folder; the suffix of ``out`` decides the format."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(out, dpi=200)
    except (OSError, ValueError) as error:  # ValueError: a format matplotlib does not know
        raise BadInput(f"{out}: cannot be written: {one_line(error)}") from None
    return out
