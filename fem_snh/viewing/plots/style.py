"""The style of all graphs: palette, axes, markers, legend."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

#: The palette of Okabe and Ito without yellow, which colour-blind readers can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
MARKERS = "osD^vP*"


def colour(index: int) -> str:
    """Return the colour of series ``index``."""
    return COLOURS[index % len(COLOURS)]


def subplots(panels: int, *, share: bool = True) -> tuple[Figure, list[Axes]]:
    """Return a figure with ``panels`` panels: up to three in a row, more in two columns.

    With ``share``, they share the horizontal axis.
    """
    columns = panels if panels <= 3 else 2
    rows = -(-panels // columns)
    figure = Figure(figsize=(4.2 * max(columns, 1), 3.3 * rows + 0.5), layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False, sharex=share).flat)
    for ax in axes[panels:]:
        ax.remove()
    for ax in axes[:panels]:
        ax.grid(True, lw=0.4, color="0.85")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelbottom=True)
        ax.yaxis.set_major_formatter(FuncFormatter(thousands))
    return figure, axes[:panels]


def style(index: int, points: int) -> dict[str, Any]:
    """Return colour, marker and line style of series ``index``; long lines have fewer markers."""
    return {
        "color": colour(index),
        "marker": MARKERS[index % len(MARKERS)],
        "ls": "-" if index < len(COLOURS) else "--",
        "ms": 4.5,
        "lw": 1.6,
        "markevery": max(1, points // 20),
    }


def plain(text: str) -> str:
    """Return a text with $ escaped: matplotlib reads text between two $ as a formula."""
    return text.replace("$", r"\$")


def draw_series(
    axes: Sequence[Axes],
    columns: Iterable[Any],
    index: int,
    label: str,
    table: pd.DataFrame,
    x: str,
) -> None:
    """Draw columns of a table over the column ``x``, one in each panel, where they are not NaN.

    The series' ``index`` chooses its colour and marker. A point that has not converged is a cross.
    """
    good = table["converged"] if "converged" in table else table[x].notna()
    for ax, column in zip(axes, columns, strict=True):
        known = table[column].notna()
        line, lost = table[good & known], table[~good & known]
        ax.plot(line[x], line[column], label=plain(label), **style(index, len(line)))
        if len(lost):
            ax.plot(lost[x], lost[column], **failure(index))


def draw_points(ax: Axes, index: int, x: Any, y: Any, label: str, edge: str = "0.2") -> None:
    """Draw measured points of series ``index`` as hollow markers."""
    marker = MARKERS[index % len(MARKERS)]
    ax.plot(x, y, ls="", marker=marker, mfc="white", mec=edge, ms=5, label=plain(label))


def failure(index: int) -> dict[str, Any]:
    """Return the style of a failed point: a cross in the colour of series ``index``."""
    return {"color": colour(index), "ls": "", "marker": "x", "ms": 7, "mew": 1.8}


def from_zero(ax: Axes) -> None:
    """Set the vertical axis from 0 to slightly above the highest value."""
    ax.set_ylim(0, 1.06 * max(ax.dataLim.y1, 1e-12))


def thousands(value: float, _: object) -> str:
    """Return a tick label with a thin space as thousands separator."""
    text = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:g}"
    return text.replace(",", "\u2009").replace("-", "\u2212")


def legend_entry(ax: Axes, label: str, marker: str) -> None:
    """Add a legend entry, a hollow marker, that belongs to no series."""
    ax.add_line(Line2D([], [], ls="", marker=marker, mfc="none", mec="0.2", mew=1.5, label=label))


def legend(figure: Figure, ax: Axes) -> None:
    """Add one legend, with the entries of ``ax``, below all panels."""
    handles, labels = ax.get_legend_handles_labels()
    fit = int(15 * figure.get_figwidth() / (8 + max(len(label) for label in labels)))
    columns = len(labels) if len(labels) <= min(fit, 4) else max(1, min(fit, 3))
    rows = -(-len(labels) // columns)
    foot = (0.1 + 0.22 * rows) / figure.get_figheight()
    figure.set_layout_engine("constrained", w_pad=0.1, h_pad=0.06, rect=(0, foot, 1, 1 - foot))
    figure.legend(handles, labels, loc="lower center", ncols=columns, frameon=False, fontsize=9)
